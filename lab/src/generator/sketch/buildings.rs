//! Towers, walls, arches, bridges, stairs, and pyramids. Each function accepts the volume in cells and draws the other
//! dimensions.

use super::shape::Sketch;
use crate::generator::dice::Dice;

/// Footprints of a tower from the ground up, each centered on the one below.
const TIERS: [&[[i32; 2]]; 14] = [
    &[[1, 1]],
    &[[2, 1]],
    &[[2, 2]],
    &[[3, 2]],
    &[[3, 1], [1, 1]],
    &[[2, 2], [2, 1]],
    &[[3, 3], [1, 1]],
    &[[3, 2], [1, 2]],
    &[[4, 2], [2, 2]],
    &[[3, 3], [3, 1], [1, 1]],
    &[[4, 4], [2, 2]],
    &[[4, 2], [2, 2], [2, 1]],
    &[[5, 3], [3, 1]],
    &[[4, 3], [2, 3], [2, 1]],
];

/// Draws narrowing tiers, with a spire from the remaining volume.
pub(super) fn tower(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let tiers = dice.pick(&TIERS);
    let mut sketch = Sketch::new("tower");
    let (mut left, mut z) = (volume, 0);
    for (i, &[a, b]) in tiers.iter().enumerate() {
        let is_last = i + 1 == tiers.len();
        let height = if is_last { left / (a * b) } else { dice.between(1, 3) };
        let at = |side: i32, below: i32| (below - side) / 2;
        sketch.add([at(a, tiers[0][0]), at(b, tiers[0][1]), z], [a, b, height]);
        left -= a * b * height;
        z += height;
        if left < 0 || height == 0 {
            return None;
        }
    }
    let [a, b] = tiers[tiers.len() - 1];
    // Put the spire in the middle if there is a middle cell, otherwise at a corner.
    let at = |side: usize, own: i32| (tiers[0][side] - own) / 2 + (own - 1) / 2;
    sketch.add([at(0, a), at(1, b), z], [1, 1, left]);
    let broad = tiers[0][0].max(tiers[0][1]);
    (sketch.extent(2) > broad && left <= 3).then_some(sketch)?.of_volume(volume)
}

/// Returns the columns of a wall's top that carry a merlon: every other one, symmetric.
fn merlons(length: i32) -> impl Iterator<Item = i32> {
    (0..length).filter(move |&x| x.min(length - 1 - x) % 2 == 0)
}

/// Draws a straight or winged wall, with battlements and a door if the volume allows.
pub(super) fn wall(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let height = dice.between(2, 5);
    let battlements = dice.chance(50);
    let door = dice.chance(40);
    let wing = dice.pick(&[0, 0, 0, 1, 2, 3]);
    let buttress = dice.chance(30);
    let mut lengths: Vec<i32> = (3..=14).collect();
    dice.shuffle(&mut lengths);
    lengths.into_iter().find_map(|length| {
        let mut sketch = Sketch::new(match (door, battlements) {
            (true, _) => "wall with a gate",
            (false, true) => "battlement",
            (false, false) => "wall",
        });
        sketch.add([0, 0, 0], [length, 1, height]);
        for x in [0, length - 1] {
            sketch.add([x, 1, 0], [1, wing, height]);
            if wing == 0 && buttress {
                sketch.add([x, -1, 0], [1, 3, 1]);
            }
        }
        if battlements {
            merlons(length).for_each(|x| sketch.add([x, 0, height], [1, 1, 1]));
        }
        if door {
            // One or two cells, whichever can be centered.
            let width = 2 - length % 2;
            let tall = (height - 1).min(3);
            sketch.cells.retain(|&[x, y, z]| {
                let off = (2 * x + 1 - length).abs();
                y != 0 || z >= tall || off >= width
            });
        }
        let proportioned = length > height && (!door || length >= 5) && (!battlements || length >= 3);
        proportioned.then_some(sketch)?.of_volume(volume)
    })
}

/// Draws piers under a lintel, one gate or a row of them, with turrets, feet, or a crest.
pub(super) fn arch(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let wide = dice.pick(&[1, 1, 1, 2]);
    let deep = dice.pick(&[1, 1, 2, 2, 3]);
    let (gap, thick) = (dice.pick(&[1, 2, 2, 3]), dice.pick(&[1, 1, 1, 2]));
    let spans = dice.pick(&[1, 1, 1, 2, 3]);
    let turret = dice.pick(&[0, 0, 1, 2]);
    let foot = dice.chance(30);
    let crest = dice.chance(30);
    let length = spans * (gap + wide) + wide;
    let words = match spans {
        1 => "arch",
        2 => "double arch",
        _ => "arcade",
    };
    (1..=7).find_map(|height| {
        let mut sketch = Sketch::new(words);
        for span in 0..=spans {
            sketch.add([span * (gap + wide), 0, 0], [wide, deep, height]);
        }
        sketch.add([0, 0, height], [length, deep, thick]);
        for x in [0, length - wide] {
            sketch.add([x, 0, height + thick], [wide, deep, turret]);
        }
        if foot {
            for x in [-1, length] {
                sketch.add([x, 0, 0], [1, deep, 1]);
            }
        }
        if crest && turret == 0 {
            let inset = (length - 1) / 2;
            sketch.add([inset, 0, height + thick], [length - 2 * inset, deep, 1]);
        }
        let open = height >= gap.min(2) && height <= 3 * gap + 2;
        open.then_some(sketch)?.of_volume(volume)
    })
}

/// Draws a deck on piers, with ramps or posts.
pub(super) fn bridge(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let (height, deep) = (dice.pick(&[1, 1, 2, 2, 3]), dice.pick(&[1, 1, 2, 2, 3]));
    let ramps = dice.chance(50);
    let posts = dice.pick(&[0, 0, 1, 2, 3]);
    let n_piers = dice.pick(&[2, 2, 2, 3, 4]);
    let mut lengths: Vec<i32> = (4..=14).collect();
    dice.shuffle(&mut lengths);
    lengths.into_iter().find_map(|length| {
        let mut sketch = Sketch::new(if posts > 1 { "bridge with pylons" } else { "bridge" });
        sketch.add([0, 0, height], [length, deep, 1]);
        // Ramps lean on the outermost piers.
        let inset = i32::from(!ramps && length > 5);
        let room = length - 1 - 2 * inset;
        if room % (n_piers - 1) != 0 || room / (n_piers - 1) < 3 {
            return None;
        }
        for x in (0..n_piers).map(|i| inset + i * room / (n_piers - 1)) {
            sketch.add([x, 0, 0], [1, deep, height]);
            for y in [0, deep - 1] {
                sketch.add([x, y, height + 1], [1, 1, posts]);
            }
        }
        if ramps {
            for step in 1..=height {
                for x in [-step, length - 1 + step] {
                    sketch.add([x, 0, 0], [1, deep, height + 1 - step]);
                }
            }
        }
        sketch.of_volume(volume)
    })
}

/// Draws solid steps: straight, up and down again, or winding.
pub(super) fn stairs(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    match dice.below(5) {
        0 => winding_stairs(volume, dice),
        1 => double_stairs(volume, dice),
        _ => straight_stairs(volume, dice),
    }
}

fn straight_stairs(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let deep = dice.pick(&[1, 1, 2, 2, 3]);
    let area = volume / deep;
    let most = (2..=8).filter(|k| k * (k + 1) / 2 <= area).max()?;
    let n_steps = dice.between((most - 2).max(2), most);
    let mut runs = vec![1; n_steps as usize];
    let mut left = area - n_steps * (n_steps + 1) / 2;
    while left > 0 {
        // The remaining volume widens steps, starting at the landing.
        let step = if dice.chance(40) && left >= n_steps { n_steps } else { dice.between(1, n_steps.min(left)) };
        runs[step as usize - 1] += 1;
        left -= step;
    }
    let mut sketch = Sketch::new("stairs");
    let mut x = 0;
    for (height, &run) in (1..).zip(&runs) {
        sketch.add([x, 0, 0], [run, deep, height]);
        x += run;
    }
    (runs.iter().all(|&run| run <= 4)).then_some(sketch)?.of_volume(volume)
}

fn double_stairs(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let (deep, run, top) = (dice.between(1, 3), dice.between(1, 2), dice.between(1, 3));
    (2..=6).find_map(|n_steps| {
        let mut sketch = Sketch::new("double stairs");
        for height in 1..=n_steps {
            let from_end = (height - 1) * run;
            sketch.add([from_end, 0, height - 1], [2 * (n_steps - height) * run + top, deep, 1]);
        }
        sketch.of_volume(volume)
    })
}

fn winding_stairs(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let rise = dice.between(1, 3);
    let first = (volume - 6 * rise) / 4;
    let mut sketch = Sketch::new("winding stairs");
    for (i, [x, y]) in (0..).zip([[0, 0], [1, 0], [1, 1], [0, 1]]) {
        sketch.add([x, y, 0], [1, 1, first + i * rise]);
    }
    (1..=3).contains(&first).then_some(sketch)?.of_volume(volume)
}

/// Draws layers that shrink on two or four sides.
pub(super) fn pyramid(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let [mut a, mut b] = dice.pick(&[[1, 1], [1, 1], [2, 1], [2, 2], [3, 1], [2, 3], [1, 3]]);
    let growth = dice.pick(&[[2, 2], [2, 2], [2, 0], [2, 1]]);
    // Some shrink on alternating sides, so that nearly every volume is possible.
    let steady = dice.chance(40);
    let (tall, finial) = (dice.pick(&[1, 1, 1, 2]), dice.pick(&[0, 0, 1, 2]));
    let mut layers = Vec::new();
    let mut left = volume - finial;
    while left > 0 {
        layers.push([a, b]);
        left -= a * b * tall;
        let [more_a, more_b] = if steady { growth } else { dice.pick(&[[2, 2], [2, 0], [0, 2]]) };
        (a, b) = (a + more_a, b + more_b);
    }
    let [a, b] = *layers.last()?;
    let mut sketch = Sketch::new(if steady && growth[1] == 0 { "ziggurat" } else { "pyramid" });
    let n_layers = layers.len() as i32;
    for (i, &[own_a, own_b]) in (0..).zip(&layers) {
        sketch.add([(a - own_a) / 2, (b - own_b) / 2, (n_layers - 1 - i) * tall], [own_a, own_b, tall]);
    }
    sketch.add([(a - 1) / 2, (b - 1) / 2, n_layers * tall], [1, 1, finial]);
    // A finial needs a middle cell.
    (layers.len() >= 2 && (finial == 0 || a * b % 2 == 1)).then_some(sketch)?.of_volume(volume)
}
