//! Labeled pictures of blueprints: a card for one, a contact sheet for many.

use blueprints::{Blueprint, Inventory};

use super::camera::{Camera, View};
use super::ground::Ground;
use super::image::{Image, Rgb, WHITE};
use super::model::{TYPE_COLORS, corners, of_blueprint};
use super::painter::Painter;
use super::text::{GRAY, INK, Type, fitted, write};
use super::texture::{NEGATIVE_COLOR, POSITIVE_COLOR};

/// Maximum number of blueprints on a contact sheet: six columns and eight rows, 1860 × 2240 pixels.
pub const MAX_TILES: usize = 48;

/// The views of a card by row.
const CARD_VIEWS: [View; 4] = [View::FrontQuarter, View::BackQuarter, View::Front, View::Top];

const HAIRLINE: Rgb = [222, 226, 233];

/// Padding around text, in pixels.
const PAD: usize = 14;

/// Heights on a card in pixels: the text above the views, and a row of the legend below.
const HEADER: usize = 80;
const LEGEND_ROW: usize = 28;

/// Width and height of a contact sheet's tiles in pixels, and height of the text at the bottom of a tile.
const TILE: [usize; 2] = [310, 280];
const TILE_FOOT: usize = 56;
const MAX_COLUMNS: usize = 6;

/// Margin around a structure, as a share of the picture's width.
const MARGIN: f32 = 0.08;

/// Minimum length shown, in meters, so that small structures do not fill the picture.
const MIN_SHOWN_M: f32 = 4.0 * blueprints::UNIT_M;

/// Draws a card of one blueprint: name, title, and size above four views, and a legend of its blocks below.
///
/// `width` is in pixels, at least 320 to fit the text; the height depends on it and on the number of block types.
pub fn card(painter: &mut Painter, blueprint: &Blueprint, width: usize) -> Image {
    let side = width / 2;
    let legend = legend(blueprint);
    let n_columns = (width / 300).max(1);
    let legend_height = legend.len().div_ceil(n_columns) * LEGEND_ROW + 2 * PAD;
    let mut image = Image::filled(width, HEADER + 2 * side + legend_height, WHITE);
    let room = width.saturating_sub(2 * PAD);
    let id = blueprint.id().as_str();
    write(&mut image, [PAD, 12], id, Type::Heading, INK);
    let after_id = Type::Heading.width(id) + PAD;
    let title = fitted(blueprint.title(), Type::Body, room.saturating_sub(after_id));
    write(&mut image, [PAD + after_id, 15], &title, Type::Body, INK);
    let [x, y, z] = blueprint.extent_u();
    let facts = format!("{}, {} blocks, {x} × {y} × {z} units", blueprint.split(), blueprint.n_blocks());
    write(&mut image, [PAD, 46], &fitted(&facts, Type::Body, room), Type::Body, GRAY);
    for (i, view) in CARD_VIEWS.into_iter().enumerate() {
        let x = i % 2 * side;
        let y = HEADER + i / 2 * side;
        image.paste(&draw_blueprint(painter, blueprint, view, [side, side]), x, y);
        write(&mut image, [x + PAD, y + PAD / 2], view.caption(), Type::Small, GRAY);
    }
    for line in [HEADER, HEADER + side, HEADER + 2 * side] {
        image.fill([0, line], [width, 1], HAIRLINE);
    }
    image.fill([side, HEADER], [1, 2 * side], HAIRLINE);
    let column_width = room / n_columns;
    for (i, (color, words)) in legend.iter().enumerate() {
        let x = PAD + i % n_columns * column_width;
        let y = HEADER + 2 * side + PAD + i / n_columns * LEGEND_ROW;
        swatch(&mut image, [x, y], *color);
        let words = fitted(words, Type::Body, column_width.saturating_sub(LEGEND_ROW));
        write(&mut image, [x + LEGEND_ROW, y], &words, Type::Body, INK);
    }
    image
}

/// Draws a grid of three-quarter views of at most [`MAX_TILES`] blueprints, each with name and title.
pub fn sheet(painter: &mut Painter, blueprints: &[&Blueprint]) -> Image {
    let shown = &blueprints[..blueprints.len().min(MAX_TILES)];
    // One row if possible, otherwise slightly wider than high.
    let n_columns = match shown.len() {
        n @ ..=MAX_COLUMNS => n.max(1),
        n => ((1.2 * n as f32).sqrt().ceil() as usize).min(MAX_COLUMNS),
    };
    let [width, height] = TILE;
    let mut image = Image::filled(n_columns * width, shown.len().div_ceil(n_columns) * height, WHITE);
    for (i, blueprint) in shown.iter().enumerate() {
        let x = i % n_columns * width;
        let y = i / n_columns * height;
        image.paste(&draw_blueprint(painter, blueprint, View::FrontQuarter, [width, height - TILE_FOOT]), x, y);
        let words = y + height - TILE_FOOT;
        write(&mut image, [x + PAD, words], blueprint.id().as_str(), Type::BodyBold, INK);
        let title = fitted(blueprint.title(), Type::Body, width - 2 * PAD);
        write(&mut image, [x + PAD, words + Type::Body.height() + 2], &title, Type::Body, GRAY);
    }
    for row in 1..shown.len().div_ceil(n_columns) {
        image.fill([PAD, row * height - 1], [n_columns * width - 2 * PAD, 1], HAIRLINE);
    }
    image
}

/// Draws a picture of the blueprint alone, with this width and height in pixels.
pub fn draw_blueprint(painter: &mut Painter, blueprint: &Blueprint, view: View, size_px: [usize; 2]) -> Image {
    let blocks = of_blueprint(blueprint);
    let shorter = size_px[0].min(size_px[1]) as f32;
    let camera = Camera::framing(view, &corners(&blocks), size_px, MARGIN * shorter, shorter / MIN_SHOWN_M);
    painter.paint(&blocks, &camera, Ground::under(&blocks))
}

/// Returns the color and label of each block type in use, then of the magnets.
fn legend(blueprint: &Blueprint) -> Vec<(Rgb, String)> {
    let inventory = Inventory::standard();
    let mut entries = Vec::new();
    for (type_idx, block_type) in inventory.types().iter().enumerate() {
        let n = blueprint.placements().iter().filter(|at| inventory.type_idx(at.block) == type_idx).count();
        if n > 0 {
            let color = TYPE_COLORS[type_idx % TYPE_COLORS.len()];
            entries.push((color, format!("{n} of {}", block_type.name)));
        }
    }
    entries.push((POSITIVE_COLOR, "positive magnets".to_owned()));
    entries.push((NEGATIVE_COLOR, "negative magnets".to_owned()));
    entries
}

/// Draws a colored square next to a line of small text.
fn swatch(image: &mut Image, [x, y]: [usize; 2], color: Rgb) {
    let side = Type::Body.height();
    image.fill([x, y], [side, side], INK);
    image.fill([x + 1, y + 1], [side - 2, side - 2], color);
}
