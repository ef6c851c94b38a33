//! Pixels of pictures, worked out by hand.

use blueprints::{BlockIdx, Catalog, Inventory, UNIT_M};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use proto::{Gripper, Pose, Scene};

use super::*;

/// A block with its center at a point in units.
fn block(type_name: &str, center_u: [f32; 3], turn: UnitQuaternion<f32>) -> Block {
    let block = Inventory::standard().blocks_of_type(type_name)[0];
    let center = Vector3::from(center_u) * UNIT_M;
    Block { block, pose: Isometry3::from_parts(center.into(), turn), shade: None, frame: None }
}

/// A cube on the ground.
fn cube(turn: UnitQuaternion<f32>) -> Block {
    block("1x1x1", [0.0, 0.0, 0.5], turn)
}

fn half_turns(n: f32, axis: Vector3<f32>) -> UnitQuaternion<f32> {
    UnitQuaternion::from_scaled_axis(axis * n * std::f32::consts::PI)
}

/// A picture of one block with a margin of four pixels.
fn paint_one(block: &Block, view: View, unit_px: usize) -> Image {
    paint(std::slice::from_ref(block), block, view, unit_px)
}

/// A square picture with `unit_px` pixels per unit, in which `framed` has a margin of four pixels.
fn paint(blocks: &[Block], framed: &Block, view: View, unit_px: usize) -> Image {
    let all = corners(std::slice::from_ref(framed));
    let camera = Camera::framing(view, &all, [unit_px + 8; 2], 4.0, f32::INFINITY);
    Painter::default().paint(blocks, &camera, Ground::under(blocks))
}

fn pixel(image: &Image, x: usize, y: usize) -> Rgb {
    image.pixels()[y * image.width() + x]
}

fn is_red(color: Rgb) -> bool {
    let [red, green, blue] = color.map(u16::from);
    red > 2 * green && red > 2 * blue
}

fn is_blue(color: Rgb) -> bool {
    let [red, green, blue] = color.map(u16::from);
    blue > 2 * red && 2 * blue > 3 * green
}

fn brightness(color: Rgb) -> u16 {
    color.into_iter().map(u16::from).sum()
}

#[test]
fn cube_from_the_front_is_a_square_with_a_disc() {
    let cube = cube(UnitQuaternion::identity());
    let image = paint_one(&cube, View::Front, 32);
    // 32 pixels wide with 4 on each side: columns and rows 4 to 35; the ground line lies below them.
    for i in 0..40 {
        let is_inside = (4..36).contains(&i);
        assert_eq!(pixel(&image, i, 12) != WHITE, is_inside, "column {i}");
        assert_eq!(pixel(&image, 20, i) != WHITE, is_inside || (36..38).contains(&i), "row {i}");
    }
    // The disc has a radius of 0.19 units or 6 pixels, so it ends before column 20 + 8; edges are dark.
    assert!(is_blue(pixel(&image, 20, 20)) && is_blue(pixel(&image, 24, 20)) && !is_blue(pixel(&image, 28, 20)));
    let [red, green, blue] = pixel(&image, 30, 10);
    assert!(red > green && green > 2 * blue, "a cube is yellow");
    assert!(2 * brightness(pixel(&image, 4, 10)) < brightness(pixel(&image, 30, 10)) * 3 / 2);
}

#[test]
fn magnets_are_red_plus_and_blue_minus_discs() {
    let check = |view: View, turn: UnitQuaternion<f32>, is_positive: bool| {
        let image = paint_one(&cube(turn), view, 80);
        // Strokes reach 0.105 units or 8 pixels from the middle (44, 44) and are 4 pixels wide; the disc reaches 15.
        let disc = pixel(&image, 44 + 7, 44 + 7);
        assert_eq!((is_red(disc), is_blue(disc)), (is_positive, !is_positive), "{view:?} {turn:?}: {disc:?}");
        let is_stroke = |x: usize, y: usize| brightness(pixel(&image, x, y)) > 550;
        assert!(is_stroke(44, 44) && is_stroke(44 + 6, 44), "{view:?} {turn:?} has no level stroke");
        assert_eq!(is_stroke(44, 44 + 6), is_positive, "{view:?} {turn:?}");
    };
    let same = UnitQuaternion::identity();
    check(View::Front, same, false);
    check(View::Front, half_turns(1.0, Vector3::z()), true);
    // The sides of +x and −x.
    check(View::Front, half_turns(-0.5, Vector3::z()), true);
    check(View::Front, half_turns(0.5, Vector3::z()), false);
    check(View::Top, same, true);
    check(View::Top, half_turns(1.0, Vector3::x()), false);
}

#[test]
fn nearer_block_hides_the_farther_in_any_order() {
    let near = cube(UnitQuaternion::identity());
    let far = block("3x2x1", [0.0, 3.0, 0.5], UnitQuaternion::identity());
    let alone = paint_one(&near, View::Front, 32);
    let both = paint(&[near.clone(), far.clone()], &near, View::Front, 32);
    assert_eq!(both, paint(&[far, near.clone()], &near, View::Front, 32));
    assert_eq!(pixel(&both, 30, 10), pixel(&alone, 30, 10));
    // Three units wide, so that it is visible on both sides of the cube.
    let [red, _, blue] = pixel(&both, 1, 20);
    assert!(blue > red && pixel(&alone, 1, 20) == WHITE);
}

#[test]
fn shadow_lies_away_from_the_light() {
    // Seen from above, light comes from (−0.2, 0.16, 1), so a cube whose center is 3 units up shades the ground around
    // (0.6, −0.48) units. It is framed as if it covered 3 units, with 20 pixels per unit and the center at (34, 34).
    let cube = block("1x1x1", [0.0, 0.0, 3.0], UnitQuaternion::identity());
    let frame = block("3x1x1", [0.0, 0.0, 3.0], UnitQuaternion::identity());
    let image = paint(std::slice::from_ref(&cube), &frame, View::Top, 60);
    let shade = |x: usize, y: usize| brightness(WHITE) - brightness(pixel(&image, x, y));
    assert!(shade(34 + 15, 34 + 11) > 100, "{}", shade(49, 45));
    assert!(shade(34 - 15, 34 - 11) < 100, "{}", shade(19, 23));
}

#[test]
fn frame_has_the_gripper_color() {
    // A frame is 0.13 units or 4 pixels wide, a plain edge one pixel.
    let edge = |frame: Option<Rgb>| {
        let block = Block { frame, ..cube(UnitQuaternion::identity()) };
        pixel(&paint_one(&block, View::Front, 32), 6, 20)
    };
    assert_eq!(edge(Some(GRIPPER_COLORS[0])), GRIPPER_COLORS[0]);
    assert_ne!(edge(None), GRIPPER_COLORS[0]);
}

#[test]
fn held_blocks_are_framed() {
    let held = BlockIdx::try_from(5).unwrap();
    let pose = |i: usize| Pose { position: [i as f32, 0.0, 0.05], orientation: [0.0, 0.0, 0.0, 1.0] };
    let grippers = [Some(Gripper::IDLE), Some(Gripper { held: Some(held), ..Gripper::IDLE })];
    let scene = Scene { grippers, ..Scene::at_rest(std::array::from_fn(pose)) };
    for (i, block) in of_scene(&scene).iter().enumerate() {
        assert_eq!((block.block.get(), block.frame), (i, (i == 5).then_some(GRIPPER_COLORS[1])));
        assert_eq!(block.pose.translation.vector, Vector3::new(i as f32, 0.0, 0.05));
    }
}

#[test]
fn blueprint_is_drawn_at_its_placements() {
    // The corners of the drawn blocks equal those of the cells that the placements fill.
    for blueprint in Catalog::builtin().iter() {
        let drawn = corners(&of_blueprint(blueprint));
        let cells: Vec<[i32; 3]> = blueprint.placements().iter().flat_map(|at| at.filled_cells()).collect();
        for axis in 0..3 {
            let high = drawn.iter().map(|point| point[axis] / UNIT_M).fold(f32::NEG_INFINITY, f32::max);
            let low = drawn.iter().map(|point| point[axis] / UNIT_M).fold(f32::INFINITY, f32::min);
            let expected = cells.iter().map(|cell| cell[axis]);
            let from = expected.clone().min().unwrap() as f32;
            let to = expected.max().unwrap() as f32 + 1.0;
            assert!((low - from).abs() < 1e-4 && (high - to).abs() < 1e-4, "{}", blueprint.id());
        }
    }
}

#[test]
fn painter_keeps_nothing_of_earlier_pictures() {
    let [first, second] = [0, 20].map(|i| Catalog::builtin().iter().nth(i).unwrap());
    let mut painter = Painter::default();
    let draw = |painter: &mut Painter, blueprint| draw_blueprint(painter, blueprint, View::FrontQuarter, [64, 48]);
    let expected = draw(&mut Painter::default(), second);
    draw(&mut painter, first);
    assert_eq!(draw(&mut painter, second), expected);
    assert_eq!(draw(&mut painter, second), expected);
}

#[test]
fn diverged_world_can_be_drawn() {
    for wrong in [f32::NAN, f32::INFINITY, 1e30, -1e30] {
        let mut lost = cube(UnitQuaternion::identity());
        lost.pose.translation.vector.x = wrong;
        let here = cube(UnitQuaternion::identity());
        for view in [View::FrontQuarter, View::Front, View::Top] {
            let alone = paint_one(&here, view, 24);
            let all = corners(std::slice::from_ref(&here));
            let camera = Camera::framing(view, &all, [32; 2], 4.0, f32::INFINITY);
            let ground = Ground::under(std::slice::from_ref(&here));
            let image = Painter::default().paint(&[lost.clone(), here.clone()], &camera, ground);
            assert_eq!(pixel(&image, 16, 16), pixel(&alone, 16, 16), "{wrong} from {view:?}");
        }
    }
}

#[test]
fn png_round_trips_and_is_deterministic() {
    let cube = cube(UnitQuaternion::identity());
    let image = paint_one(&cube, View::Front, 32);
    let bytes = encode(&image, 256).unwrap();
    assert_eq!(bytes, encode(&paint_one(&cube, View::Front, 32), 256).unwrap());
    let mut decoder = ::png::Decoder::new(std::io::Cursor::new(bytes));
    decoder.set_transformations(::png::Transformations::EXPAND);
    let mut reader = decoder.read_info().unwrap();
    let mut decoded = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut decoded).unwrap();
    assert_eq!((info.width, info.height, info.color_type), (40, 40, ::png::ColorType::Rgb));
    // Orthographic and axis-aligned: few enough colors for an exact palette.
    assert_eq!(decoded, image.pixels().concat());
}

#[test]
fn cards_and_sheets_have_the_requested_size() {
    let all: Vec<_> = Catalog::builtin().iter().take(8).collect();
    let mut painter = Painter::default();
    let card = card(&mut painter, all[0], 320);
    // Text, two rows of views, and at most eight kinds of blocks and magnets in the legend.
    assert!(card.width() == 320 && (400..720).contains(&card.height()), "{}", card.height());
    // √(1.2 · 8) = 3.1: four columns of 310 pixels and two rows of 280.
    let sheet = sheet(&mut painter, &all);
    assert_eq!((sheet.width(), sheet.height()), (1240, 560));
}
