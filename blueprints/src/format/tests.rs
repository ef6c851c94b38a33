//! Errors of form name the location, the cause, and the remedy.

use super::*;
use crate::checks::check_text;

/// Returns the error of a file with this text, without the file's name.
fn error(text: &str) -> String {
    check_text("my tower.toml", text).blueprint.unwrap_err().error.to_string()
}

/// Returns the error of a file with this block on its third line, after a valid one.
fn error_of_block(block: &str) -> String {
    error(&format!("blocks = [\n{{ type = \"1x1x1\", at = [0, 0, 0] }},\n{{ {block} }},\n]"))
}

#[test]
fn a_place_or_size_that_is_not_three_whole_numbers_names_its_key_and_block() {
    for (cells, shown) in [
        ("[2, 0.5, 1]", "[2, 0.5, 1]"),
        ("[2.0, 0, 1]", "[2.0, 0, 1]"),
        ("[2, 0]", "[2, 0]"),
        ("[0, 0, 1, 1]", "[0, 0, 1, 1]"),
        ("7", "7"),
        ("\"2 0 1\"", "\"2 0 1\""),
        // Shown on one line.
        ("[0, \"x\\ny\", 1]", "[0, \"\"\" x y\"\"\", 1]"),
    ] {
        let needs = |key: &str, block: &str| {
            format!(
                "line 3: block {block:?}: `{key}` needs three whole numbers of cells, like [2, 1, 1], and is {shown}"
            )
        };
        let named = error_of_block(&format!("name = \"end\", type = \"1x1x1\", at = {cells}"));
        assert_eq!(named, needs("at", "end"));
        let unnamed = error_of_block(&format!("type = \"2x1x1\", at = [0, 0, 1], size = {cells}"));
        assert_eq!(unnamed, needs("size", "block-2"));
    }
    let long = error_of_block(&format!("type = \"1x1x1\", at = [{}]", "0, ".repeat(1000)));
    assert!(long.ends_with("0, 0,…") && long.len() < 200, "{long}");
}

#[test]
fn the_line_is_that_of_the_value() {
    let text = "blocks = [\n{ type = \"1x1x1\", at = [0, 0, 0] },\n{ type = \"1x1x1\",\n  at = [0, 0] },\n]";
    assert!(error(text).starts_with("line 4: block \"block-2\": `at` needs"), "{}", error(text));
    let tables = "[[blocks]]\ntype = \"1x1x1\"\nat = [0, 0, 0]\n\n[[blocks]]\ntype = \"1x1x1\"\nat = [0, 0.5, 0]";
    assert!(error(tables).starts_with("line 7: block \"block-2\": `at` needs"), "{}", error(tables));
}

#[test]
fn a_number_too_large_for_any_drawing_is_shown() {
    let far = error_of_block("type = \"1x1x1\", at = [0, 0, 1099511627776]");
    assert_eq!(far, "block \"block-2\": cell [0, 0, 1099511627776] is outside -64..=64");
    let large = error_of_block("type = \"2x1x1\", at = [0, 0, 1], size = [1099511627776, 1, 1]");
    assert!(large.contains("`size` needs three whole numbers of cells"), "{large}");
}

#[test]
fn a_missing_key_names_the_block() {
    assert_eq!(
        error_of_block("type = \"1x1x1\""),
        "line 3: block \"block-2\" has no `at`; add the lowest-numbered corner cell that it fills, like at = [0, 0, 0]"
    );
    assert_eq!(
        error_of_block("name = \"end\", at = [0, 0, 1]"),
        "line 3: block \"end\" has no `type`; add its size in cells, like type = \"2x1x1\""
    );
}

#[test]
fn what_is_no_block_is_told_what_one_looks_like() {
    let message = error("blocks = [\n3]");
    assert_eq!(
        message,
        "line 2: invalid type: integer `3`, expected a block like { type = \"1x1x1\", at = [0, 0, 0] }"
    );
}

#[test]
fn names_that_are_empty_and_names_that_are_taken_differ() {
    let empty = error_of_block("name = \"\", type = \"1x1x1\", at = [0, 0, 1]");
    assert_eq!(empty, "block 2 of the list has an empty name; give it one, or leave its `name` out");
    // A block without a name is named after its position.
    let taken = error_of_block("name = \"block-1\", type = \"1x1x1\", at = [0, 0, 1]");
    assert_eq!(taken, "blocks 1 and 2 of the list are both called \"block-1\"; give one of them another name");
}

#[test]
fn too_few_and_too_many_blocks_are_counted_in_words() {
    let of = |n: usize| error(&format!("blocks = [{}]", "{ type = \"1x1x1\", at = [0, 0, 0] },".repeat(n)));
    assert_eq!(of(0), "the file has no blocks; a blueprint needs 2 to 16, so add some");
    assert_eq!(of(1), "the file has 1 block; a blueprint needs 2 to 16, so add some");
    assert_eq!(of(17), "the file has 17 blocks; a blueprint needs 2 to 16, so leave some out");
}

#[test]
fn points_of_placed_blocks_are_found_in_the_file_again() {
    for up in ["+x", "-x", "+y", "-y", "+z", "-z"] {
        let text = format!(
            "up = \"{up}\"\nblocks = [{{ type = \"3x2x1\", at = [10, -7, 3], axes = \"+y +z\" }}, \
             {{ type = \"2x1x1\", at = [4, 5, 6], axes = \"-z +x\" }}]"
        );
        let draft = Draft::parse("drawn.toml", &text).unwrap();
        let turns: Vec<CubeRotation> = draft.blocks.iter().filter_map(|block| block.turn).collect();
        let placements = draft.place(&draft.assign().unwrap(), &turns);
        // Centers in the file's coordinates: 1 x 3 x 2 cells from [10, -7, 3], and 1 x 1 x 2 from [4, 5, 6].
        let centers = placements.iter().map(|p| draft.drawn(p.center_half_units, &placements));
        assert_eq!(centers.collect::<Vec<_>>(), [[21, -11, 8], [9, 11, 14]], "{up}");
    }
}
