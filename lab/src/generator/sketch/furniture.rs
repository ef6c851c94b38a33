//! Tables, rings, and crosses. Each function accepts the volume in cells and draws the other dimensions.

use super::shape::Sketch;
use crate::generator::dice::Dice;

/// Draws a plate on legs, walls, or a pedestal. Two plates form a shelf, a back makes a bench, and any remaining volume
/// goes on top.
pub(super) fn table(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let (wide, deep) = (dice.between(2, 6), dice.between(1, 4));
    let levels = dice.pick(&[1, 1, 1, 2]);
    let kind = dice.below(3);
    let with_back = dice.chance(25);
    let mut heights: Vec<i32> = (1..=4).collect();
    dice.shuffle(&mut heights);
    heights.into_iter().find_map(|height| {
        let mut sketch = Sketch::new("table");
        for level in 0..levels {
            let z = level * (height + 1);
            sketch.add([0, 0, z + height], [wide, deep, 1]);
            match kind {
                0 => {
                    for (x, y) in [(0, 0), (wide - 1, 0), (0, deep - 1), (wide - 1, deep - 1)] {
                        sketch.add([x, y, z], [1, 1, height]);
                    }
                }
                1 => [0, wide - 1].into_iter().for_each(|x| sketch.add([x, 0, z], [1, deep, height])),
                _ => {
                    // A pedestal with sides of the plate's parity can stand in its middle.
                    let (foot_a, foot_b) = (2 - wide % 2, 2 - deep % 2);
                    sketch.add([(wide - foot_a) / 2, (deep - foot_b) / 2, z], [foot_a, foot_b, height]);
                }
            }
        }
        let top = levels * (height + 1);
        let left = volume - sketch.cells.len() as i32;
        let open = kind == 2 || (wide >= 3 && (wide > 2 * deep - 4 || kind == 0));
        if levels == 2 {
            sketch.words = "shelf".to_owned();
        } else if kind == 2 {
            sketch.words = "table on a pedestal".to_owned();
        }
        if with_back && left > 0 && left % wide == 0 && left / wide <= 3 && deep >= 2 && levels == 1 {
            sketch.add([0, deep - 1, top], [wide, 1, left / wide]);
            sketch.words = "bench".to_owned();
        } else if (1..=3).contains(&left) {
            sketch.add([(wide - 1) / 2, (deep - 1) / 2, top], [1, 1, left]);
            sketch.words += " with a vase";
        }
        // A shelf needs walls or legs.
        (open && (kind < 2 || levels == 1)).then_some(())?;
        sketch.of_volume(volume)
    })
}

/// Draws a closed frame, lying with corner posts or upright on feet.
pub(super) fn ring(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let a = dice.between(3, 8);
    let b = dice.between(3, 8);
    let layers = dice.pick(&[1, 1, 2, 3]);
    let frame = 2 * (a + b) - 4;
    let left = volume - frame * layers;
    if left < 0 || a < b {
        return None;
    }
    let upright = dice.chance(40);
    let mut sketch = Sketch::new(if upright { "standing ring" } else { "ring" });
    if upright {
        let (wide, tall) = if dice.chance(50) { (a, b) } else { (b, a) };
        for x in [0, wide - 1] {
            sketch.add([x, 0, 0], [1, layers, tall]);
            // Feet on both sides keep a thin ring from falling.
            for y in [-1, layers] {
                sketch.add([x, y, 0], [1, i32::from(left == 4), 1]);
            }
        }
        for z in [0, tall - 1] {
            sketch.add([0, 0, z], [wide, layers, 1]);
        }
    } else {
        for x in [0, a - 1] {
            sketch.add([x, 0, 0], [1, b, layers]);
            for y in [0, b - 1] {
                sketch.add([x, y, layers], [1, 1, left / 4]);
            }
        }
        for y in [0, b - 1] {
            sketch.add([0, y, 0], [a, 1, layers]);
        }
        if left > 0 {
            sketch.words = "ring with corner posts".to_owned();
        }
    }
    (left / 4 <= 3).then_some(sketch)?.of_volume(volume)
}

/// Draws four arms on the ground with something in the middle, or an upright cross on a foot.
pub(super) fn cross(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let wide = dice.pick(&[1, 1, 2]);
    if dice.chance(50) {
        let arm_x = dice.between(1, 6);
        let arm_y = dice.between(1, 6);
        let layers = dice.pick(&[1, 1, 1, 2]);
        let tips = dice.pick(&[0, 0, 1, 2]);
        let step = dice.pick(&[0, 0, 1]);
        (0..=6).find_map(|mast| {
            let mut sketch = Sketch::new(if mast > 0 { "cross with a mast" } else { "lying cross" });
            sketch.add([-arm_x, 0, 0], [2 * arm_x + wide, wide, layers]);
            sketch.add([0, -arm_y, 0], [wide, 2 * arm_y + wide, layers]);
            sketch.add([-step, 0, layers], [2 * step + wide, wide, step]);
            sketch.add([0, -step, layers], [wide, 2 * step + wide, step]);
            sketch.add([0, 0, layers], [wide, wide, mast]);
            for x in [-arm_x, arm_x + wide - 1] {
                sketch.add([x, 0, layers], [1, wide, tips]);
            }
            for y in [-arm_y, arm_y + wide - 1] {
                sketch.add([0, y, layers], [wide, 1, tips]);
            }
            let fits = arm_x.abs_diff(arm_y) <= 2 && step < arm_x.min(arm_y) && (step == 0 || mast > 0);
            (fits && (tips == 0 || arm_x.min(arm_y) > 1)).then_some(sketch)?.of_volume(volume)
        })
    } else {
        let deep = dice.pick(&[1, 1, 2, 2, 3]);
        let arm = dice.between(1, 4);
        let foot = dice.pick(&[0, 1, 1, 2]);
        let thick = dice.pick(&[wide, wide, wide + 1]);
        (3..=12).find_map(|tall| {
            let mut sketch = Sketch::new("standing cross");
            sketch.add([0, 0, 0], [wide, deep, tall]);
            // The bar sits in the upper half, below the top of the shaft.
            let bar = tall - thick - (tall - thick) / 3;
            sketch.add([-arm, 0, bar.max(1)], [2 * arm + wide, deep, thick]);
            match foot {
                1 => sketch.add([-1, 0, 0], [wide + 2, deep, 1]),
                2 => sketch.add([-1, -1, 0], [wide + 2, deep + 2, 1]),
                _ => {}
            }
            (bar >= 2 && bar + thick < tall && bar <= 2 * arm + 4 && deep <= wide + 1)
                .then_some(sketch)?
                .of_volume(volume)
        })
    }
}
