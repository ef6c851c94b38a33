//! Structures that are as long or as tall as the stock and the checks allow: one or two cells wide, with plates where a
//! line has room for them.

use super::shape::Sketch;
use crate::generator::brick::Stock;
use crate::generator::dice::Dice;

/// A long, symmetric row with wider sections, called bays.
struct Row {
    length: i32,
    /// First cell and width of each bay.
    bays: Vec<[i32; 2]>,
}

/// Draws a line of blocks whose bays are a wall's turrets, a viaduct's piers, the laps of a zigzag, and so on.
pub(super) fn longest(n_blocks: usize, idea: usize, dice: &mut Dice) -> Option<Sketch> {
    let (least, most) = Stock::full().volume_range(n_blocks);
    let volume = dice.between((most - 4).max(least), most);
    match idea % 6 {
        0 => {
            let row = Row::draw(volume, dice)?;
            let mut sketch = Sketch::new("long wall with turrets");
            sketch.add([0, 0, 0], [row.length, 1, 1]);
            row.bays.iter().for_each(|&[x, width]| sketch.add([x, 0, 1], [width, 1, 1]));
            sketch.of_volume(volume)
        }
        1 => {
            let row = Row::draw(volume, dice)?;
            let mut sketch = Sketch::new("viaduct");
            sketch.add([0, 0, 1], [row.length, 1, 1]);
            row.bays.iter().for_each(|&[x, width]| sketch.add([x, 0, 0], [width, 1, 1]));
            sketch.of_volume(volume)
        }
        2 => {
            let row = Row::draw(volume, dice)?;
            let mut sketch = Sketch::new("zigzag");
            let mut from = 0;
            for (i, bay) in (0..).zip(row.bays.iter().chain(&[[row.length, 0]])) {
                let end = bay[0] + bay[1];
                sketch.add([from, i % 2, 0], [end - from, 1, 1]);
                from = bay[0];
            }
            sketch.of_volume(volume)
        }
        3 => {
            // Feet on both sides next to the bays' plates, like a caterpillar's.
            let feet = 4;
            let row = Row::draw(volume - feet, dice)?;
            let mut sketch = Sketch::new("causeway");
            sketch.add([0, 0, 0], [row.length, 1, 1]);
            for (i, &[x, width]) in (0..).zip(&row.bays) {
                let outer = i == 0 || i + 1 == row.bays.len();
                sketch.add([x, if outer { 1 } else { -1 }, 0], [width, 1, 1]);
            }
            for x in [0, row.length - 1] {
                sketch.add([x, -1, 0], [1, 3, 1]);
            }
            sketch.of_volume(volume)
        }
        4 => suspension_bridge(volume, dice),
        _ => balance(volume, dice),
    }
}

impl Row {
    /// Draws a row whose length and bays together fill the volume.
    fn draw(volume: i32, dice: &mut Dice) -> Option<Self> {
        let half = dice.pick(&[[3, 2], [2, 3]]);
        // With few blocks, use at most one pair of plates.
        let n_bays = if volume >= 30 { 2 } else { dice.between(0, 2) };
        let half = &half[..n_bays as usize];
        let length = volume - 2 * half.iter().sum::<i32>();
        let room = length / 2 - half.iter().sum::<i32>();
        if room < n_bays + 1 {
            return None;
        }
        let mut bays = Vec::new();
        let mut x = 0;
        let gap = room / (n_bays + 1);
        for (i, &width) in half.iter().enumerate() {
            x += if i == 0 { dice.between(0, gap) } else { dice.between(gap, gap + 2) };
            bays.push([x, width]);
            x += width;
        }
        if x >= length / 2 && n_bays > 0 {
            return None;
        }
        bays.extend(bays.clone().iter().rev().map(|&[x, width]| [length - x - width, width]));
        Some(Self { length, bays })
    }
}

/// Draws a deck two cells up, on two-by-two piers, with a pylon over each.
fn suspension_bridge(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let pylon = dice.pick(&[2, 3, 3]);
    let ends = dice.pick(&[0, 2]);
    let length = volume - 2 * 4 - 2 * 2 * pylon - 2 * ends;
    let overhang = if ends > 0 { dice.between(3, 6) } else { dice.between(2, 4) };
    let mut sketch = Sketch::new("suspension bridge");
    sketch.add([0, 0, 2], [length, 1, 1]);
    for x in [overhang, length - overhang - 2] {
        sketch.add([x, 0, 0], [2, 1, 2]);
        sketch.add([x, 0, 3], [2, 1, pylon]);
    }
    for x in [0, length - 1] {
        sketch.add([x, 0, 2 - ends], [1, 1, ends]);
    }
    let span = length - 2 * overhang - 4;
    (length >= 12 && (3..=12).contains(&span)).then_some(sketch)?.of_volume(volume)
}

/// Draws a beam that balances on one foot, thicker in the middle.
fn balance(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let (foot_height, foot_wide) = (dice.between(1, 2), dice.between(3, 5));
    let tip = dice.between(2, 3);
    let left = volume - foot_height * foot_wide;
    // Two high in the middle, one high at the tips.
    let thick = (left - 2 * tip) / 2;
    let length = thick + 2 * tip;
    let mut sketch = Sketch::new("balancing beam");
    sketch.add([0, 0, foot_height + 1], [length, 1, 1]);
    sketch.add([tip, 0, foot_height], [thick, 1, 1]);
    sketch.add([(length - foot_wide) / 2, 0, 0], [foot_wide, 1, foot_height]);
    ((length - foot_wide) % 2 == 0 && length >= 10).then_some(sketch)?.of_volume(volume)
}

/// Draws a wide base, a shaft two cells wide, and a thin mast. The base is plates, crossed feet, legs, tiers, or a
/// ladder.
pub(super) fn tallest(n_blocks: usize, idea: usize, dice: &mut Dice) -> Option<Sketch> {
    let (least, most) = Stock::full().volume_range(n_blocks);
    let volume = dice.between((most - 4).max(least), most);
    // One magnet pair may carry seven cells.
    let mast = dice.between(3, 7);
    let (mut sketch, base_height, [x, y]) = match idea % 5 {
        0 => plates(dice),
        1 => crossed_feet(dice),
        2 => legs(dice),
        3 => tiers(dice),
        _ => ladder(dice),
    };
    let left = volume - sketch.cells.len() as i32 - mast;
    let shaft = left / 2;
    let odd = left % 2;
    sketch.add([x, y, base_height], [2, 1, shaft]);
    sketch.add([x, y, base_height + shaft], [1, 1, mast + odd]);
    (shaft >= 2).then_some(sketch)?.of_volume(volume)
}

/// Draws one or two plates with the shaft in the middle.
fn plates(dice: &mut Dice) -> (Sketch, i32, [i32; 2]) {
    let [a, b] = dice.pick(&[[4, 3], [4, 3], [4, 2]]);
    let mut sketch = Sketch::new("needle");
    sketch.add([0, 0, 0], [a, b, 1]);
    (sketch, 1, [(a - 2) / 2, (b - 1) / 2])
}

/// Draws four long feet.
fn crossed_feet(dice: &mut Dice) -> (Sketch, i32, [i32; 2]) {
    let (along, across) = (dice.between(1, 3), dice.between(1, 3));
    let mut sketch = Sketch::new("radio mast");
    sketch.add([-along, 0, 0], [2 * along + 2, 1, 1]);
    sketch.add([0, -across, 0], [2, 2 * across + 1, 1]);
    (sketch, 1, [0, 0])
}

/// Draws two legs on crossed feet, under a beam.
fn legs(dice: &mut Dice) -> (Sketch, i32, [i32; 2]) {
    let height = dice.between(4, 6);
    let mut sketch = Sketch::new("tower on two legs");
    sketch.add([-1, 0, 0], [4, 1, 1]);
    for x in [-1, 2] {
        sketch.add([x, -1, 0], [1, 3, 1]);
        sketch.add([x, 0, 0], [1, 1, height]);
    }
    sketch.add([-1, 0, height], [4, 1, 1]);
    (sketch, height + 1, [0, 0])
}

/// Draws two tiers below the shaft.
fn tiers(dice: &mut Dice) -> (Sketch, i32, [i32; 2]) {
    let (low, high) = (dice.between(1, 2), dice.between(2, 4));
    let mut sketch = Sketch::new("skyscraper");
    sketch.add([-1, 0, 0], [4, 2, low]);
    sketch.add([0, 0, low], [2, 2, high]);
    (sketch, low + high, [0, 0])
}

/// Draws two posts with rungs between them.
fn ladder(dice: &mut Dice) -> (Sketch, i32, [i32; 2]) {
    let n_rungs = dice.between(2, 4);
    let mut sketch = Sketch::new("ladder tower");
    sketch.add([-1, -1, 0], [4, 3, 1]);
    let height = 3 * n_rungs;
    for x in [-1, 2] {
        sketch.add([x, 0, 1], [1, 1, height]);
    }
    for rung in 1..=n_rungs {
        sketch.add([-1, 0, 3 * rung], [4, 1, 1]);
    }
    (sketch, height + 1, [0, 0])
}
