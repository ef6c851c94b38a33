//! A long row with ribs, shorter than the records: blocks far apart, without the shapes that are held out.

use super::Sketch;
use crate::generator::dice::Dice;

/// Longest row in cells. The shortest structure of the style `longest` in the catalog has 25.
const MAX_LENGTH: i32 = 22;

/// A row one cell wide and high, sometimes doubled for a part of its length, with ribs of one to three by one or two cells
/// to the left, to the right, and on top.
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
        // Plates find room only in broad ribs.
        let width = dice.between(1, 3).min(length - x).min(left / reach.max(1));
        if left == 0 {
            break;
        }
        let (low, size) = match side {
            0 => ([x, 1, 0], [width, reach, 1]),
            1 => ([x, -reach, 0], [width, reach, 1]),
            _ => ([x, 0, 1], [width, 1, reach]),
        };
        // Ribs side by side would make a plate of the whole.
        let root = [x, [1, -1, 0][side as usize], i32::from(side == 2)];
        if (-1..=width).any(|dx| sketch.cells.contains(&[root[0] + dx, root[1], root[2]])) {
            continue;
        }
        sketch.add(low, size);
        left -= width * reach;
    }
    sketch.of_volume(volume)
}
