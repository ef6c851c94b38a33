//! Each kind of invalid file gets its own error, which names the culprit.

use blueprints::checks::{Check, Outcome, check_text};
use proptest::prelude::*;

const GOOD: &str = r#"
id = "3_000"
split = "train"
title = "corner"
provenance = "drawn for a test"

blocks = [
    { name = "bar", type = "3x1x1", at = [0, 0, 0], axes = "+x +y" },
    { name = "end", type = "1x1x1", at = [2, 0, 1], axes = "+x +y" },
    { name = "top", type = "1x1x1", at = [2, 0, 2], axes = "+x +y" },
]

connections = [
    { a = "bar", b = "end", magnets = ["+z(2,0,0) -z(0,0,0)"] },
    { a = "end", b = "top", magnets = ["+z(0,0,0) -z(0,0,0)"] },
]
"#;

#[test]
fn good_file_is_valid() {
    let report = check_text("corner.toml", GOOD);
    assert!(report.passed(), "{report:#?}");
}

#[test]
fn drawing_is_rotated_so_that_up_is_positive_z() {
    // The same three blocks drawn with their height along +x.
    let lying = GOOD
        .replace("provenance", "up = \"+x\"\nprovenance")
        .replace("[0, 0, 0], axes = \"+x +y\"", "[0, 0, 0], axes = \"+y +z\"")
        .replace("[2, 0, 1], axes = \"+x +y\"", "[1, 2, 0], axes = \"+y +z\"")
        .replace("[2, 0, 2], axes = \"+x +y\"", "[2, 2, 0], axes = \"+y +z\"");
    let turned = check_text("lying.toml", &lying).blueprint.expect("it stands once turned");
    let upright = check_text("corner.toml", GOOD).blueprint.expect("it stands");
    assert_eq!(turned.canonical_hash(), upright.canonical_hash());
    let heights = turned.placements().iter().map(|p| p.center_half_units[2]);
    assert!(heights.eq(upright.placements().iter().map(|p| p.center_half_units[2])));
    let flat = lying.replace("up = \"+x\"\n", "");
    assert!(check_text("flat.toml", &flat).passed(), "the same drawing with +z up lies on the ground");
}

/// Replaces `from` in the good file and expects `check` to fail first, with exactly `error`.
fn check(from: &str, to: &str, failing: Check, error: &str) {
    assert!(GOOD.contains(from), "the good file does not contain {from:?}");
    let report = check_text("broken.toml", &GOOD.replacen(from, to, 1));
    let first = report.results.iter().find(|result| result.outcome != Outcome::Passed);
    let first = first.unwrap_or_else(|| panic!("{from:?} → {to:?} passed"));
    assert_eq!((first.check, &first.outcome), (failing, &Outcome::Failed { error: error.to_owned() }));
    let refused = report.blueprint.expect_err("a failed check refuses the file");
    assert_eq!(refused.to_string(), format!("broken.toml: {error}"));
}

#[test]
fn form_errors_name_the_line_or_the_value() {
    let form = |from: &str, to: &str, error: &str| check(from, to, Check::Format, error);
    form(
        "title",
        "color",
        "line 4: unknown field `color`, expected one of `id`, `split`, `title`, `provenance`, `up`, `blocks`, \
         `connections`",
    );
    form(
        "\"3_000\"",
        "\"4_000\"",
        "the id 4_000 promises 4 blocks, the file has 3; an id of another form promises nothing",
    );
    form("\"corner\"", "\" \"", "field `title` is empty");
    form("title", "up = \"z\"\ntitle", "up \"z\" is not one of +x, -x, +y, -y, +z, -z");
    form(
        "axes = \"+x +y\"",
        "axes = \"+x -x\"",
        "block \"bar\": axes \"+x -x\" are not two different axes like \"+x +y\"",
    );
    form("[2, 0, 1]", "[2, 0, 2000000000]", "block \"end\": cell [2, 0, 2000000000] is outside -64..=64");
    form("b = \"end\"", "b = \"ned\"", "a connection names the block \"ned\", which the file does not have");
    form("b = \"end\"", "b = \"bar\"", "block \"bar\" is connected to itself");
    form("[\"+z(2,0,0) -z(0,0,0)\"]", "[]", "the connection of \"bar\" and \"end\" lists no magnets");
    form(
        "+z(2,0,0) -z(0,0,0)",
        "+w(2,0,0) -z(0,0,0)",
        "magnet pair \"+w(2,0,0) -z(0,0,0)\" is not of the form \"+z(0,0,0) -z(0,0,0)\"",
    );
    form(
        "\"+z(2,0,0) -z(0,0,0)\"",
        "\"+z(2,0,0) -z(0,0,0)\", \"+z(2,0,0) -z(0,0,0)\"",
        "magnet pair \"+z(2,0,0) -z(0,0,0)\" of \"bar\" and \"end\" is listed twice",
    );
}

#[test]
fn structure_errors_name_the_blocks() {
    check(
        "\"3x1x1\"",
        "\"5x1x1\"",
        Check::Inventory,
        "block \"bar\" has the unknown type \"5x1x1\"; the inventory has 1x1x1, 2x1x1, 3x1x1, 4x1x1, 2x2x1, 3x2x1",
    );
    check(
        "[2, 0, 1]",
        "[2, 0, 0]",
        Check::Overlap,
        "blocks \"bar\" and \"end\" overlap in cell [2, 0, 0]; move one of them",
    );
    check(
        "    { a = \"end\", b = \"top\", magnets = [\"+z(0,0,0) -z(0,0,0)\"] },\n",
        "",
        Check::Connections,
        "blocks \"end\" and \"top\" also meet with the magnets \"+z(0,0,0) -z(0,0,0)\"; list the pair",
    );
    check(
        "+z(2,0,0) -z(0,0,0)",
        "+z(1,0,0) -z(0,0,0)",
        Check::Connections,
        "the magnets \"+z(1,0,0) -z(0,0,0)\" of blocks \"bar\" and \"end\" do not meet with opposite poles",
    );
}

#[test]
fn disconnected_and_tipping_structures_are_refused() {
    // When the top cube moves away it loses its only pair, so remove the pair too.
    let loose = GOOD
        .replace("at = [2, 0, 2]", "at = [2, 0, 5]")
        .replace("    { a = \"end\", b = \"top\", magnets = [\"+z(0,0,0) -z(0,0,0)\"] },\n", "");
    let error = check_text("loose.toml", &loose).blueprint.expect_err("it is in two pieces").to_string();
    assert_eq!(error, "loose.toml: block \"top\" is not connected to \"bar\"");
    // The bar on a cube at its end: center at (2.5 + 1.5·3 + 2.5) / 5 = 1.9 along x, support from 2 to 3.
    let tipping = GOOD
        .replace("at = [0, 0, 0]", "at = [0, 0, 1]")
        .replace("at = [2, 0, 1]", "at = [2, 0, 0]")
        .replace("+z(2,0,0) -z(0,0,0)", "-z(2,0,0) +z(0,0,0)")
        .replace(
            "a = \"end\", b = \"top\", magnets = [\"+z(0,0,0)",
            "a = \"bar\", b = \"top\", magnets = [\"+z(2,0,0)",
        );
    let error = check_text("tipping.toml", &tipping).blueprint.expect_err("it tips over").to_string();
    let expected = "tipping.toml: the structure tips over: its center of mass is 0.10 u outside the outline of what it stands \
                    on, and must be at least 0.1 u inside; put more of its lowest layer under it";
    assert_eq!(error, expected);
}

#[test]
fn overload_error_names_the_connection() {
    let text = r#"
id = "3_000"
split = "train"
title = "diving board"
provenance = "drawn for a test"

blocks = [
    { name = "foot", type = "3x2x1", at = [0, 0, 0], axes = "+x +y" },
    { name = "post", type = "2x1x1", at = [0, 0, 1], axes = "+z +y" },
    { name = "board", type = "3x1x1", at = [1, 0, 2], axes = "-x +y" },
]

connections = [
    { a = "foot", b = "post", magnets = ["+z(0,0,0) -x(0,0,0)"] },
    { a = "post", b = "board", magnets = ["-z(1,0,0) +x(2,0,0)"] },
]
"#;
    // Board: 3 cells of 1.962 N at 1.5 u are 0.88 N m. With the post, 5 cells at 1.2 u: 1.18 N m.
    let report = check_text("board.toml", text);
    assert!(report.passed(), "{report:#?}");
    // On the foot, the post and a board of four are 6 cells with their center at x = (2·0.5 + 4·3) / 6 = 2.17 u, the
    // contact's at 0.5 u, so 11.77 N at 0.167 m.
    let longer = text.replace("3x1x1\", at = [1", "4x1x1\", at = [1").replace("+x(2,0,0)", "+x(3,0,0)");
    let report = check_text("board.toml", &longer);
    let strength = report.results.iter().find(|r| r.check == Check::Strength).expect("all checks are listed");
    let error = "the connection of \"foot\" and \"post\" carries 11.8 N and 1.96 N m; 1 magnet pair(s) may \
                 carry 15 N and 1.50 N m";
    assert_eq!(strength.outcome, Outcome::Failed { error: error.to_owned() });
    assert_eq!(report.blueprint.expect_err("too long").to_string(), format!("board.toml: {error}"));
}

#[test]
fn too_many_blocks_of_a_type_are_refused() {
    let cube = |i: i32| format!("{{ name = \"c{i}\", type = \"3x1x1\", at = [0, 0, {i}], axes = \"+x +y\" }}, ");
    let text = format!(
        "id = \"3_000\"\nsplit = \"train\"\ntitle = \"pile\"\nprovenance = \"test\"\nblocks = [{}]\nconnections = []",
        (0..3).map(cube).collect::<String>()
    );
    let report = check_text("pile.toml", &text);
    let error = report.blueprint.expect_err("there are two bars").to_string();
    assert_eq!(error, "pile.toml: block \"c2\" is one too many of type 3x1x1: the inventory has 2");
    // Checks that need the blocks are skipped, not passed.
    let n_skipped = report.results.iter().filter(|r| r.outcome == Outcome::Skipped).count();
    assert_eq!((report.results.len(), n_skipped), (Check::ALL.len() - 1, 8));
}

proptest! {
    #[test]
    fn arbitrary_text_never_panics(text in ".{0,200}") {
        prop_assert!(!check_text("any.toml", &text).passed());
    }

    #[test]
    fn damaged_files_never_panic(at in 0..GOOD.len(), with in "[ -~]{0,3}") {
        let mut text = GOOD.to_owned();
        text.replace_range(at..=at, &with);
        let report = check_text("damaged.toml", &text);
        prop_assert_eq!(report.passed(), report.blueprint.is_ok());
    }
}
