//! A long row with ribs, shorter than the record styles: it puts blocks far apart without the held-out shapes.

use super::shape::Sketch;
use crate::generator::dice::Dice;

/// Maximum length of a row in cells. The shortest structure of style `longest` in the catalog has 25.
const MAX_LENGTH: i32 = 22;

/// Draws a row one cell wide and high, sometimes doubled for part of its length. Ribs of one to three by one or two
/// cells extend to the left, to the right, and upward.
pub(super) fn spine(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let length = dice.between((volume / 3).max(3), (volume - 1).clamp(3, MAX_LENGTH));
    let mut sketch = Sketch::new("spine with ribs");
    sketch.add([0, 0, 0], [length, 1, 1]);
    let mut left = volume - length;
    if length >= 6 && dice.chance(40) {
        let thick = dice.between(3, length / 2).min(left);
        sketch.add([dice.between(0, length - thick), 1, 0], [thick, 1, 1]);
        left -= thick;
    }
    let mut places: Vec<[i32; 2]> = (0..length).flat_map(|x| (0..3).map(move |side| [x, side])).collect();
    dice.shuffle(&mut places);
    for [x, side] in places {
        let reach = dice.between(1, 2).min(left);
        // Only broad ribs have room for plates.
        let width = dice.between(1, 3).min(length - x).min(left / reach.max(1));
        if left == 0 {
            break;
        }
        let (low, size) = match side {
            0 => ([x, 1, 0], [width, reach, 1]),
            1 => ([x, -reach, 0], [width, reach, 1]),
            _ => ([x, 0, 1], [width, 1, reach]),
        };
        // Adjacent ribs would merge into one plate.
        let root = [x, [1, -1, 0][side as usize], i32::from(side == 2)];
        if (-1..=width).any(|dx| sketch.cells.contains(&[root[0] + dx, root[1], root[2]])) {
            continue;
        }
        sketch.add(low, size);
        left -= width * reach;
    }
    sketch.of_volume(volume)
}
