//! Capital letters, standing or lying, with strokes of one or two cells.

use super::shape::Sketch;
use crate::generator::dice::Dice;

/// Letters on a grid of three columns and five rows, top row first. Strokes run down the outer columns in this list and
/// down the middle column in the next.
const OUTER: [(&str, [&str; 5]); 11] = [
    ("A", ["###", "#.#", "###", "#.#", "#.#"]),
    ("C", ["###", "#..", "#..", "#..", "###"]),
    ("E", ["###", "#..", "###", "#..", "###"]),
    ("F", ["###", "#..", "###", "#..", "#.."]),
    ("H", ["#.#", "#.#", "###", "#.#", "#.#"]),
    ("J", ["..#", "..#", "..#", "#.#", "###"]),
    ("L", ["#..", "#..", "#..", "#..", "###"]),
    ("O", ["###", "#.#", "#.#", "#.#", "###"]),
    ("P", ["###", "#.#", "###", "#..", "#.."]),
    ("S", ["###", "#..", "###", "..#", "###"]),
    ("U", ["#.#", "#.#", "#.#", "#.#", "###"]),
];
const MIDDLE: [(&str, [&str; 5]); 2] =
    [("I", ["###", ".#.", ".#.", ".#.", "###"]), ("T", ["###", ".#.", ".#.", ".#.", ".#."])];

/// Draws a letter with exactly that volume.
pub(super) fn letter(volume: i32, dice: &mut Dice) -> Option<Sketch> {
    let middle = dice.chance(20);
    let (name, rows) = if middle { dice.pick(&MIDDLE) } else { dice.pick(&OUTER) };
    let stroke = dice.pick(&[1, 1, 2]);
    let deep = dice.pick(&[1, 1, 2, 3]);
    // A letter can be stretched between its strokes.
    let stretch = dice.between(stroke, stroke + 2);
    let columns = if middle { [stretch, stroke, stretch] } else { [stroke, stretch, stroke] };
    let (upper, lower) = (dice.between(1, 4), dice.between(1, 4));
    let heights = [stroke, upper, stroke, if dice.chance(70) { upper } else { lower }, stroke];
    let (lying, plinth) = (dice.chance(25), dice.chance(25));
    let mut sketch = Sketch::new(&format!("letter {name}"));
    let mut z = heights.iter().sum::<i32>();
    for (row, height) in rows.iter().zip(heights) {
        z -= height;
        let mut x = 0;
        for (mark, width) in row.bytes().zip(columns) {
            if mark == b'#' {
                sketch.add([x, 0, z], [width, deep, height]);
            }
            x += width;
        }
    }
    let width = columns.iter().sum();
    if lying {
        sketch.words = format!("letter {name} lying");
        sketch.cells = sketch.cells.iter().map(|&[x, y, z]| [x, z, y]).collect();
    } else if plinth {
        sketch.words = format!("letter {name} on a plinth");
        sketch.add([0, 0, -1], [width, deep, 1]);
    }
    sketch.of_volume(volume)
}
