//! Heat maps: blueprints from top to bottom, training steps from left to right.

use blueprints::Split;

use super::axis::{StepUnit, borders, ticks};
use super::color::{BRACKETS, FAINT, INK, NOTHING, Scale};
use super::drawing::{Anchor, Drawing};
use crate::picture::Type;
use runlog::series::{Difference, Grid, Row};

/// Margin around everything, pixels.
const MARGIN: usize = 24;
/// Space above the cells for title and subtitle, pixels.
const HEAD: usize = 96;
/// Space below the cells for the axis of steps, pixels.
const FOOT: usize = 72;
/// Space between columns of labels, and between labels and cells, pixels.
const GAP: usize = 14;
/// Distance from the end of a label to its bracket, pixels.
const BRACKET: f64 = 6.5;
/// White space between sizes and between splits, pixels.
const BETWEEN_SIZES: usize = 3;
const BETWEEN_SPLITS: usize = 10;
/// Total height of the rows, and minimum and maximum height of one row, pixels; the minimum fits a line of text.
const ROWS_HEIGHT: usize = 480;
const ROW_HEIGHT: [usize; 2] = [18, 36];
/// Minimum and maximum total width of the columns, and maximum width of one column, pixels.
const CELLS_WIDTH: [usize; 2] = [520, 1100];
const COLUMN_WIDTH: usize = 48;
/// The color bar: maximum height, width, and space to its right for labels, pixels.
const BAR_HEIGHT: usize = 360;
const BAR_WIDTH: usize = 22;
const BAR_LABELS: usize = 96;
/// Distance from the color bar to the center of its title, pixels.
const BAR_TITLE: f64 = 70.0;

/// Draws a heat map of success rates; the title describes the values, and the subtitle names the run.
pub fn success_map(grid: &Grid, title: &str, subtitle: &str) -> Drawing {
    heat_map(grid, Scale::Rate, title, subtitle)
}

/// Draws a heat map of differences between success rates: blue if the first run is better, red if the second is.
pub fn difference_map(difference: &Difference, title: &str, subtitle: &str) -> Drawing {
    heat_map(&difference.grid, Scale::Difference, title, subtitle)
}

/// Rows grouped under one label.
struct Block {
    label: String,
    top: usize,
    bottom: usize,
}

/// Positions in pixels.
struct Layout {
    /// Top edge of each row.
    tops: Vec<usize>,
    row_height: usize,
    bottom: usize,
    splits: Vec<Block>,
    sizes: Vec<Block>,
    /// Right edges of the labels of splits, sizes, and ids.
    label_ends: [usize; 3],
    left: usize,
    width: usize,
}

impl Layout {
    fn new(grid: &Grid) -> Self {
        let n_rows = grid.rows.len().max(1);
        let row_height = (ROWS_HEIGHT / n_rows).clamp(ROW_HEIGHT[0], ROW_HEIGHT[1]);
        let mut y = HEAD;
        let mut tops = Vec::with_capacity(n_rows);
        let (mut splits, mut sizes): (Vec<Block>, Vec<Block>) = (Vec::new(), Vec::new());
        let mut before: Option<&Row> = None;
        for row in &grid.rows {
            let same_split = before.is_some_and(|before| before.split == row.split);
            let same_size = same_split && before.is_some_and(|before| before.n_blocks == row.n_blocks);
            y += match (before, same_split, same_size) {
                (None, ..) | (_, true, true) => 0,
                (_, true, false) => BETWEEN_SIZES,
                (_, false, _) => BETWEEN_SPLITS,
            };
            let bottom = y + row_height;
            extend(&mut splits, same_split, (y, bottom), || split_label(row.split).to_owned());
            extend(&mut sizes, same_size, (y, bottom), || size_label(row.n_blocks));
            tops.push(y);
            y = bottom;
            before = Some(row);
        }
        let widest =
            |labels: &mut dyn Iterator<Item = &str>, kind: Type| labels.map(|l| kind.width(l)).max().unwrap_or(0);
        // A rotated title, then the labels of splits, sizes, and ids.
        let split_end =
            MARGIN + Type::Body.height() + GAP + widest(&mut splits.iter().map(|b| &*b.label), Type::BodyBold);
        let size_end = split_end + GAP + widest(&mut sizes.iter().map(|b| &*b.label), Type::Small);
        let id_end = size_end + GAP + widest(&mut grid.rows.iter().map(|row| row.id.as_str()), Type::Small);
        let width = (COLUMN_WIDTH * grid.steps.len()).clamp(CELLS_WIDTH[0], CELLS_WIDTH[1]);
        let label_ends = [split_end, size_end, id_end];
        Self { tops, row_height, bottom: y, splits, sizes, label_ends, left: id_end + GAP, width }
    }

    fn right(&self) -> usize {
        self.left + self.width
    }
}

/// Adds a row to the last block, or starts a new one.
fn extend(blocks: &mut Vec<Block>, same: bool, (top, bottom): (usize, usize), label: impl FnOnce() -> String) {
    match blocks.last_mut() {
        Some(block) if same => block.bottom = bottom,
        _ => blocks.push(Block { label: label(), top, bottom }),
    }
}

fn split_label(split: Split) -> &'static str {
    match split {
        Split::Train => "train",
        Split::Test => "test",
        Split::TestLiteral => "test literal",
        Split::TestLongest => "test longest",
        Split::TestTallest => "test tallest",
        Split::Validation => "validation",
    }
}

fn size_label(n_blocks: u64) -> String {
    format!("{n_blocks} blocks")
}

fn heat_map(grid: &Grid, scale: Scale, title: &str, subtitle: &str) -> Drawing {
    let layout = Layout::new(grid);
    let bar_height = (layout.bottom - HEAD).clamp(BAR_HEIGHT / 2, BAR_HEIGHT);
    let text_end = MARGIN + Type::Heading.width(title).max(Type::Body.width(subtitle));
    let width = (layout.right() + 2 * GAP + BAR_WIDTH + BAR_LABELS).max(text_end) + MARGIN;
    // Leave space for the note below the color bar.
    let height = (layout.bottom + FOOT).max(HEAD + bar_height + FOOT);
    let mut drawing = Drawing::new(width, height);
    drawing.text(title, [MARGIN as f64, 36.0], Anchor::Start, Type::Heading, INK);
    drawing.text(subtitle, [MARGIN as f64, 64.0], Anchor::Start, Type::Body, FAINT);
    labels(&mut drawing, grid, &layout);
    cells(&mut drawing, grid, &layout, scale);
    color_bar(&mut drawing, grid, &layout, scale, bar_height);
    drawing
}

fn labels(drawing: &mut Drawing, grid: &Grid, layout: &Layout) {
    let middle = |top: usize, bottom: usize| (top + bottom) as f64 / 2.0;
    let [split_end, size_end, id_end] = layout.label_ends.map(|end| end as f64);
    for (blocks, end) in [(&layout.splits, split_end), (&layout.sizes, size_end)] {
        for block in blocks {
            // A bracket on the side of the rows that the label belongs to.
            let (x, top, bottom) = (end + BRACKET, block.top as f64 + 1.5, block.bottom as f64 - 1.5);
            drawing.line(vec![[x, top], [x, bottom]], 1.0, BRACKETS);
        }
    }
    for block in &layout.splits {
        let at = [split_end, middle(block.top, block.bottom)];
        drawing.text(&*block.label, at, Anchor::End, Type::BodyBold, INK);
    }
    for block in &layout.sizes {
        drawing.text(&*block.label, [size_end, middle(block.top, block.bottom)], Anchor::End, Type::Small, FAINT);
    }
    for (row, top) in grid.rows.iter().zip(&layout.tops) {
        let at = [id_end, middle(*top, top + layout.row_height)];
        drawing.text(row.id.as_str(), at, Anchor::End, Type::Small, INK);
    }
    let at = [(MARGIN + Type::Body.height() / 2) as f64, middle(HEAD, layout.bottom)];
    let height = layout.bottom - HEAD;
    let title = ["blueprint, by split and number of blocks", "blueprint", ""];
    let title = title.into_iter().find(|text| Type::Body.width(text) <= height).unwrap_or_default();
    drawing.text(title, at, Anchor::Turned, Type::Body, INK);
}

fn cells(drawing: &mut Drawing, grid: &Grid, layout: &Layout, scale: Scale) {
    let borders = borders(&grid.steps);
    let (Some(&low), Some(&high)) = (borders.first(), borders.last()) else { return };
    let place = |steps: f64| layout.left as f64 + (steps - low) / (high - low) * layout.width as f64;
    let edges: Vec<usize> = borders.iter().map(|border| place(*border).round() as usize).collect();
    if scale == Scale::Difference {
        // No difference is nearly white: draw a frame around the map, and lines where the size changes.
        for block in &layout.splits {
            let size = [layout.width + 2, block.bottom - block.top + 2];
            drawing.rect([layout.left - 1, block.top - 1], size, BRACKETS);
        }
    }
    for (values, &top) in grid.values.iter().zip(&layout.tops) {
        let colors: Vec<_> = values.iter().map(|value| value.map_or(NOTHING, |value| scale.color(value))).collect();
        // Merge neighbors of one color into one rectangle: a plot of a hundred evaluations needs half as many.
        let mut column = 0;
        for same in colors.chunk_by(|a, b| a == b) {
            let (left, right) = (edges[column], edges[column + same.len()]);
            drawing.rect([left, top], [right - left, layout.row_height], same[0]);
            column += same.len();
        }
    }
    let unit = StepUnit::of(grid.steps.last().map_or(0.0, |steps| *steps as f64));
    let marks = match grid.steps[..] {
        // A single evaluation need not have a round number of steps.
        [only] => vec![only as f64],
        _ => ticks(low.max(0.0), high, 8),
    };
    let bottom = layout.bottom as f64;
    for mark in marks {
        let x = place(mark);
        drawing.line(vec![[x, bottom + 4.0], [x, bottom + 10.0]], 1.0, INK);
        drawing.text(unit.label(mark), [x, bottom + 24.0], Anchor::Middle, Type::Body, INK);
    }
    let middle = layout.left as f64 + layout.width as f64 / 2.0;
    drawing.text(unit.title, [middle, bottom + 50.0], Anchor::Middle, Type::Body, INK);
}

fn color_bar(drawing: &mut Drawing, grid: &Grid, layout: &Layout, scale: Scale, height: usize) {
    let left = layout.right() + 2 * GAP;
    let [low, high] = scale.range();
    let at = |value: f64| HEAD as f64 + (high - value) / (high - low) * height as f64;
    for y in 0..height {
        let value = high - (y as f64 + 0.5) / height as f64 * (high - low);
        drawing.rect([left, HEAD + y], [BAR_WIDTH, 1], scale.color(value));
    }
    let right = (left + BAR_WIDTH) as f64;
    for i in 0..=4 {
        let value = low + f64::from(i) / 4.0 * (high - low);
        let label = match scale {
            Scale::Rate => format!("{:.0}", 100.0 * value),
            Scale::Difference => format!("{:+.0}", 100.0 * value).replace("+0", "0"),
        };
        drawing.line(vec![[right + 2.0, at(value)], [right + 7.0, at(value)]], 1.0, INK);
        drawing.text(label, [right + 12.0, at(value)], Anchor::Start, Type::Body, INK);
    }
    let title = match scale {
        Scale::Rate => "success (%)",
        Scale::Difference => "difference (percentage points)",
    };
    drawing.text(title, [right + BAR_TITLE, HEAD as f64 + height as f64 / 2.0], Anchor::Turned, Type::Body, INK);
    if grid.values.iter().flatten().any(Option::is_none) {
        let top = HEAD + height + GAP;
        drawing.rect([left, top], [BAR_WIDTH, BAR_WIDTH], NOTHING);
        drawing.text("not evaluated", [right + 8.0, top as f64 + 11.0], Anchor::Start, Type::Small, FAINT);
    }
}
