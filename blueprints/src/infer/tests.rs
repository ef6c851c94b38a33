//! Tests of inference on handmade drawings.

use proptest::prelude::*;

use crate::checks::{Check, Inferred, Outcome, Report, check_text};
use crate::{Blueprint, Catalog, Link, Split};

/// Checks a file with these lines for its blocks.
fn check(blocks: &str) -> Report {
    check_text("folder/my tower.toml", &format!("blocks = [\n{blocks}\n]"))
}

fn notes(report: &Report) -> Vec<String> {
    report.inferred.iter().map(ToString::to_string).collect()
}

#[test]
fn type_and_at_are_enough() {
    let report = check("{ type = \"3x1x1\", at = [0, 0, 0] },\n{ type = \"1x1x1\", at = [2, 0, 1] }");
    let blueprint = report.blueprint.as_ref().unwrap();
    assert_eq!((blueprint.id().as_str(), blueprint.title(), blueprint.split()), ("my-tower", "my-tower", Split::Train));
    let expected = [
        "block \"block-1\" is turned \"+x +y\": it can fill [3, 1, 1] cells only",
        "block \"block-2\" is turned \"+x +y\"",
        "blocks \"block-1\" and \"block-2\" are connected by 1 magnet pair",
    ];
    assert_eq!(notes(&report), expected);
    let completed = report.completed.unwrap();
    let again = check_text("other.toml", &completed);
    assert_eq!((again.blueprint.as_ref(), &again.inferred[..]), (Ok(blueprint), &[][..]), "{completed}");
}

#[test]
fn of_several_ways_the_one_with_the_most_magnets_is_taken_and_said() {
    // The upper bar could lie along x or y, or stand. Along x, all three of its cells meet the lower bar. Along y, it
    // would tip over, which still counts as a way.
    let blocks = "{ name = \"low\", type = \"3x1x1\", at = [0, 0, 0], size = [3, 1, 1] },\n\
                  { name = \"top\", type = \"3x1x1\", at = [0, 0, 1] }";
    let report = check(blocks);
    let top = &notes(&report)[1];
    let of_three = "block \"top\" is turned \"+x +y\": of 3 ways it fills [3, 1, 1] cells, chosen by the checks and then by \
                    the most magnets that meet";
    assert_eq!(top, of_three);
    assert!(report.inferred[1].is_a_choice() && !report.inferred[0].is_a_choice());
    let stands = check(&blocks.replace("at = [0, 0, 1]", "at = [0, 0, 1], size = [1, 1, 3]"));
    assert_eq!(stands.blueprint.unwrap().extent_u(), [3, 1, 4]);
}

#[test]
fn a_block_that_poles_leave_one_turn_is_said_to_have_no_other() {
    // The cubes decide the slab's signs along x and y, and with them the one along z.
    let report = check(
        "{ type = \"3x2x1\", at = [0, 0, 0], size = [3, 2, 1] },\n\
         { type = \"1x1x1\", at = [3, 0, 0], axes = \"+x +y\" },\n\
         { type = \"1x1x1\", at = [0, 2, 0], axes = \"-x -y\" }",
    );
    let only = "block \"block-1\" is turned \"+x -y\": it can fill [3, 2, 1] cells only, and its neighbors' poles leave \
                no other turn";
    assert_eq!(notes(&report)[0], only);
}

#[test]
fn given_turns_decide_the_poles_of_their_neighbors() {
    // The low brick's −x points along +x and its −z up, so the brick on it has to be flipped too.
    let report = check(
        "{ name = \"low\", type = \"2x1x1\", at = [0, 0, 0], axes = \"-x +y\" },\n\
         { name = \"top\", type = \"2x1x1\", at = [0, 0, 1], size = [2, 1, 1] },\n\
         { name = \"side\", type = \"1x1x1\", at = [2, 0, 0] }",
    );
    let blueprint = report.blueprint.as_ref().unwrap();
    let signs = |i: usize, axis: usize| blueprint.placements()[i].rotation.signs()[axis];
    // Cubes are numbered before bricks.
    assert_eq!((signs(2, 2), signs(0, 0)), (-1, -1), "{:?}", notes(&report));
}

#[test]
fn what_cannot_be_is_refused_by_name() {
    let error = |blocks: &str| check(blocks).blueprint.unwrap_err().to_string();
    let cube = |at: &str| format!("{{ type = \"1x1x1\", at = {at} }}");
    let bar = |rest: &str| format!("{{ name = \"bar\", type = \"3x1x1\", at = [0, 0, 0]{rest} }}");
    let around = [cube("[1, 0, 0]"), cube("[0, 1, 0]"), cube("[0, 0, 1]")].join(",\n");
    for (blocks, words) in [
        (
            format!("{},\n{around}", bar("")),
            "block \"bar\" of type 3x1x1 at [0, 0, 0] overlaps another block whichever",
        ),
        (format!("{},\n{}", bar(", size = [2, 1, 1]"), cube("[0, 0, 1]")), "cannot fill [2, 1, 1] cells"),
        (
            format!("{},\n{}", bar(", size = [3, 1, 1], axes = \"+y +x\""), cube("[0, 0, 1]")),
            "turned by its axes it fills [1, 3, 1] cells, its size is [3, 1, 1]",
        ),
        (format!("{},\n{}", cube("[0, 0, 0]"), cube("[0, 0, 0]")), "\"block-1\" and \"block-2\" overlap"),
        (format!("{},\n{}", cube("[0, 0, 0]"), cube("[0, 0, 2]")), "block \"block-2\" is not connected"),
        (format!("{},\n{}", bar(", size = [1, 1, 3]"), "{ type = \"4x1x1\", at = [-3, 0, 3] }"), "center of mass"),
        ([cube("[0, 0, 0]").as_str(); 10_000].join(",\n"), "the file has 10000 blocks"),
    ] {
        let message = error(&blocks);
        assert!(message.contains(words), "{message}");
    }
    let open = "connections = [{ a = \"block-1\", b = \"block-2\", magnets = [\"+z(0,0,0) -z(0,0,0)\"] }]\nblocks = [\
                { type = \"1x1x1\", at = [0, 0, 0] }, { type = \"1x1x1\", at = [0, 0, 1] }]";
    let message = check_text("a.toml", open).blueprint.unwrap_err().to_string();
    assert!(message.contains("block \"block-1\" has no axes, and `connections` names magnets"), "{message}");
}

/// Many blocks with many ways, none of which exclude each other: an exhaustive search would not end.
#[test]
fn a_search_is_bounded() {
    let all: Vec<(&str, usize)> =
        vec![("2x1x1", 4), ("3x1x1", 2), ("4x1x1", 2), ("2x2x1", 2), ("3x2x1", 2), ("1x1x1", 4)];
    let each = all.iter().flat_map(|&(name, n)| std::iter::repeat_n(name, n)).enumerate();
    let line =
        |(i, name): (usize, &str)| format!("{{ type = \"{name}\", at = [{}, {}, 0] }}", 5 * (i % 4), 5 * (i / 4));
    let apart: Vec<String> = each.map(line).collect();
    let report = check(&apart.join(",\n"));
    assert!(notes(&report)[0].contains(": of at least "), "{:?}", notes(&report));
    let error = report.blueprint.unwrap_err().to_string();
    assert!(error.contains("is not connected to"), "{error}");
}

/// Returns the blueprint's file without `axes`, without `connections`, or without both.
fn without(blueprint: &Blueprint, axes: bool, connections: bool) -> String {
    let mut table: toml::Table = blueprint.to_toml("a test").parse().unwrap();
    if connections {
        table.remove("connections");
    }
    if axes {
        let blocks = table.get_mut("blocks").and_then(toml::Value::as_array_mut).unwrap();
        blocks.iter_mut().for_each(|block| drop(block.as_table_mut().unwrap().remove("axes")));
    }
    toml::to_string(&table).unwrap()
}

#[test]
fn links_of_the_catalog_are_found_again() {
    for blueprint in Catalog::builtin().iter() {
        let report = check_text("stripped.toml", &without(blueprint, false, true));
        assert_eq!(report.blueprint.as_ref(), Ok(blueprint));
        let n_links = report.inferred.iter().filter(|note| matches!(note, Inferred::Pairs { .. })).count();
        assert_eq!((n_links, report.inferred.len()), (blueprint.links().len(), n_links));
    }
}

fn n_pairs(blueprint: &Blueprint) -> usize {
    blueprint.links().iter().map(|link: &Link| usize::from(link.n_magnet_pairs)).sum()
}

#[test]
fn all_of_the_catalog_stands_without_its_axes() {
    for blueprint in Catalog::builtin().iter() {
        let report = check_text("stripped.toml", &without(blueprint, true, true));
        let found = report.blueprint.as_ref().unwrap_or_else(|error| panic!("{}: {error}", blueprint.id()));
        assert_eq!(found.n_blocks(), blueprint.n_blocks());
        assert!(n_pairs(found) >= n_pairs(blueprint), "{}: another way had more", blueprint.id());
    }
}

proptest! {
    /// Every file gets a verdict, and a blueprint that passes can be written and read back.
    #[test]
    fn any_drawing_gets_an_answer(
        blocks in prop::collection::vec((0_usize..6, prop::array::uniform3(0..3)), 2..8),
        turned in any::<bool>(),
    ) {
        let types = ["1x1x1", "2x1x1", "3x1x1", "4x1x1", "2x2x1", "3x2x1"];
        let axes = if turned { ", axes = \"-x +y\"" } else { "" };
        let line = |(i, (kind, at)): (usize, &(usize, [i32; 3]))| {
            let axes = if i == 0 { axes } else { "" };
            format!("{{ type = \"{}\", at = {at:?}{axes} }}", types[*kind])
        };
        let lines: Vec<String> = blocks.iter().enumerate().map(line).collect();
        let report = check(&lines.join(",\n"));
        match (&report.blueprint, &report.completed) {
            (Ok(blueprint), Some(completed)) => {
                let again = check_text("again.toml", completed).blueprint;
                prop_assert_eq!(again.as_ref(), Ok(blueprint));
            }
            (Ok(_), None) => prop_assert_eq!(report.inferred.len(), 0),
            (Err(_), _) => {
                let is_failed = |outcome: &Outcome| matches!(outcome, Outcome::Failed { .. });
                prop_assert_eq!(report.results.iter().any(|result| is_failed(&result.outcome)), true);
                prop_assert_eq!(report.results.len(), Check::ALL.len() - 1);
            }
        }
    }
}
