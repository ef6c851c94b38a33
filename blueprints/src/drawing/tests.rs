//! Findings about drawings, and rotations of their free blocks.

use proptest::prelude::*;

use super::*;

fn block(type_name: &str, at: [i32; 3], axes: &str) -> DrawnBlock {
    DrawnBlock { type_name: type_name.to_owned(), at, axes: axes.to_owned(), is_free: false }
}

fn free(type_name: &str, at: [i32; 3], axes: &str) -> DrawnBlock {
    DrawnBlock { is_free: true, ..block(type_name, at, axes) }
}

fn drawing(blocks: Vec<DrawnBlock>) -> Drawing {
    Drawing { title: "a test".to_owned(), blocks }
}

/// Returns the failed checks with the blocks concerned.
fn problems(blocks: Vec<DrawnBlock>) -> Vec<(Check, Vec<usize>)> {
    let found = drawing(blocks).examine().unwrap();
    assert_eq!(found.blueprint.is_some(), found.problems.is_empty());
    found.problems.into_iter().map(|problem| (problem.check, problem.blocks)).collect()
}

#[test]
fn a_post_on_a_plank_is_a_blueprint() {
    let drawing = drawing(vec![block("2x1x1", [5, 5, 3], "+x +y"), block("1x1x1", [5, 5, 4], "+x +y")]);
    let found = drawing.examine().unwrap();
    assert_eq!(found.connections, [Connection { a: 0, b: 1, n_magnet_pairs: 1 }]);
    let blueprint = found.blueprint.unwrap();
    assert!(blueprint.id().as_str().starts_with("drawn_2_"), "{}", blueprint.id());
    // The written file reads back as a drawing, on the ground and at the origin.
    let again = Drawing::from_toml(&blueprint.to_toml("a test")).unwrap();
    assert_eq!(again.blocks, [block("1x1x1", [0, 0, 1], "+x +y"), block("2x1x1", [0, 0, 0], "+x +y")]);
    assert_eq!(again.examine().unwrap().blueprint, Some(blueprint));
}

#[test]
fn every_problem_names_its_blocks() {
    let cube = |at| block("1x1x1", at, "+x +y");
    assert_eq!(problems(vec![cube([0, 0, 0]), cube([0, 0, 0])])[0], (Check::Overlap, vec![0, 1]));
    // Upside down, with the negative side up: like poles meet.
    let flipped = block("1x1x1", [0, 0, 1], "+x -y");
    assert_eq!(problems(vec![cube([0, 0, 0]), flipped]), [(Check::Polarity, vec![0, 1]), (Check::Connected, vec![1])]);
    assert_eq!(problems(vec![cube([0, 0, 0]), cube([1, 0, 0]), cube([5, 0, 0])]), [(Check::Connected, vec![2])]);
    assert_eq!(problems(vec![cube([0, 0, 0]), block("4x1x1", [0, 0, 1], "+x +y")]), [(Check::Stands, vec![])]);
}

#[test]
fn the_last_checks_speak_of_the_blocks_as_drawn() {
    // Six arms around a cube, which stands on the lowest arm: whichever arm comes first tips it.
    let mut jack = drawing(vec![
        free("4x1x1", [1, 0, 0], "+x +y"),
        free("1x1x1", [0, 0, 0], "+x +y"),
        free("4x1x1", [-4, 0, 0], "+x +y"),
        free("3x1x1", [0, 1, 0], "+y +x"),
        free("3x1x1", [0, -3, 0], "+y +x"),
        free("2x1x1", [0, 0, 1], "+z +x"),
        free("2x1x1", [0, 0, -2], "+z +x"),
    ]);
    jack.turn_free_blocks().unwrap();
    let problems = jack.examine().unwrap().problems;
    let checks: Vec<Check> = problems.iter().map(|problem| problem.check).collect();
    assert_eq!(checks, [Check::Strength, Check::Assembly], "{problems:?}");
    assert!(problems[0].blocks.contains(&1) && problems[0].text.contains("cube"), "{problems:?}");
    assert!(problems[1].text.starts_with("the expert cannot place bar 1 and bar 2: "), "{problems:?}");
}

#[test]
fn free_blocks_turn_until_poles_meet() {
    let mut drawn = drawing(vec![
        block("1x1x1", [0, 0, 0], "+x +y"),
        free("1x1x1", [0, 0, 1], "+x -y"),
        free("3x2x1", [1, 0, 0], "-x +y"),
    ]);
    drawn.turn_free_blocks().unwrap();
    assert_eq!(drawn.blocks[0].axes, "+x +y", "it is not free");
    let found = drawn.examine().unwrap();
    assert!(found.problems.iter().all(|problem| problem.check != Check::Polarity), "{:?}", found.problems);
    assert_eq!(found.connections.len(), 2);
    // Both point their own x along −x.
    let mut fitting = drawing(vec![free("1x1x1", [0, 0, 0], "-x +y"), free("1x1x1", [1, 0, 0], "-x -y")]);
    for drawn in [&mut drawn, &mut fitting] {
        let turned = drawn.clone();
        drawn.turn_free_blocks().unwrap();
        assert_eq!(*drawn, turned, "what fits stays");
    }
}

#[test]
fn blocks_that_there_are_not_are_refused() {
    let refused =
        |type_name: &str, at, axes: &str| drawing(vec![free(type_name, at, axes)]).examine().unwrap_err().to_string();
    assert!(refused("1x1x1", [0, 65, 0], "+x +y").contains("outside -64..=64"));
    assert!(refused("1x1x1", [0, 0, i32::MIN], "+x +y").contains("outside -64..=64"));
    for axes in ["", "+x", "+x +x", "+x -x", "x y", "+x +y "] {
        assert!(refused("1x1x1", [0, 0, 0], axes).contains("not two different axes"), "{axes}");
    }
    let unknown = drawing(vec![block("9x9x9", [0, 0, 0], "+x +y")]);
    assert!(unknown.examine().unwrap_err().to_string().contains("unknown type \"9x9x9\""));
    let many = drawing((0..5).map(|x| block("1x1x1", [x, 0, 0], "+x +y")).collect());
    assert!(many.examine().unwrap_err().to_string().contains("one too many of type 1x1x1"));
    assert!(many.clone().turn_free_blocks().is_err());
}

#[test]
fn titles_are_short_and_plain() {
    let mut drawn = drawing(vec![block("1x1x1", [0, 0, 0], "+x +y"), block("1x1x1", [1, 0, 0], "+x +y")]);
    for (title, expected) in [("", UNTITLED), (" \n", UNTITLED), ("a\u{7}b", "ab"), (&"x".repeat(999), &"x".repeat(80))]
    {
        drawn.title = title.to_owned();
        assert_eq!(drawn.examine().unwrap().blueprint.unwrap().title(), expected);
    }
}

proptest! {
    #[test]
    fn no_drawing_is_too_strange(
        strange in prop::collection::vec((0..6_usize, prop::array::uniform3(-3..4_i32), 0..24_u8, any::<bool>()), 0..10),
    ) {
        let types = Inventory::standard().types();
        let blocks = strange.iter().map(|&(of, at, turn, is_free)| DrawnBlock {
            type_name: types[of].name.to_owned(),
            at,
            axes: CubeRotation::try_from(turn).unwrap().axes(),
            is_free,
        });
        let mut drawn = drawing(blocks.collect());
        if drawn.turn_free_blocks().is_ok() {
            let found = drawn.examine().unwrap();
            prop_assert!(found.problems.iter().all(|p| p.blocks.iter().all(|&i| i < strange.len())));
            prop_assert!(found.blueprint.is_none() || found.problems.is_empty());
        }
    }
}
