//! Tests of single checks on handmade blueprints.

use super::*;
use crate::assembly::tests::jack;

#[test]
fn assembly_error_names_the_unplaced_blocks() {
    // No file can isolate this failure: a structure that cannot be assembled is also too weak for its magnets.
    let placements = jack();
    let line = |p: &Placement| {
        let type_name = Inventory::standard().block_type(p.block).name;
        format!("{{ type = {type_name:?}, at = {:?}, axes = {:?} }},", p.lowest_cell(), p.rotation.axes())
    };
    let lines: String = placements.iter().map(line).collect();
    let draft = Draft::parse("jack.toml", &format!("blocks = [{lines}]")).unwrap();
    let error = Structure::new(&draft, &placements).assembly().unwrap_err();
    let BlueprintError::NoAssembly { blocks, gave_up: false } = &error else { panic!("{error}") };
    assert!(!blocks.is_empty() && blocks.iter().all(|name| draft.blocks.iter().any(|b| b.name == *name)), "{error}");
}

/// Returns the outcome of a check.
fn outcome(report: &Report, check: Check) -> &Outcome {
    &report.results.iter().find(|result| result.check == check).unwrap().outcome
}

/// Returns the failed checks with their errors.
fn failures(report: &Report) -> Vec<(Check, &str)> {
    let failed = report.results.iter().filter_map(|result| match &result.outcome {
        Outcome::Failed { error } => Some((result.check, error.as_str())),
        Outcome::Passed | Outcome::Skipped => None,
    });
    failed.collect()
}

#[test]
fn overlaps_are_told_where_the_file_has_them_and_alone() {
    for up in ["+x", "-x", "+y", "-y", "+z", "-z"] {
        let text = format!(
            "up = \"{up}\"\nblocks = [\n\
             {{ name = \"a\", type = \"2x1x1\", at = [10, 10, -3], size = [2, 1, 1] }},\n\
             {{ name = \"b\", type = \"1x1x1\", at = [11, 10, -3] }},\n]"
        );
        let report = check_text("pair.toml", &text);
        let expected = (Check::Overlap, "blocks \"a\" and \"b\" overlap in cell [11, 10, -3]; move one of them");
        assert_eq!(failures(&report)[..1], [expected], "{up}");
        for check in [Check::Connected, Check::Strength] {
            assert_eq!(*outcome(&report, check), Outcome::Skipped, "{up}");
        }
    }
}

#[test]
fn like_poles_are_told_where_the_file_has_them_and_alone() {
    let text = "blocks = [\n\
                { name = \"a\", type = \"1x1x1\", at = [10, 10, 0], axes = \"+x +y\" },\n\
                { name = \"b\", type = \"1x1x1\", at = [11, 10, 0], axes = \"-x +y\" },\n]";
    let report = check_text("pair.toml", text);
    let repel = "blocks \"a\" and \"b\" repel: like poles meet at [11.0, 10.5, 0.5], pair \"+x(0,0,0) +x(0,0,0)\"; turn one, \
                 or leave out its `axes`";
    assert_eq!(failures(&report), [(Check::Polarity, repel)]);
    assert_eq!(*outcome(&report, Check::Connected), Outcome::Skipped);
    assert_eq!(*outcome(&report, Check::Stands), Outcome::Passed);
    // The same with the height along +x.
    let report = check_text("pair.toml", &format!("up = \"+x\"\n{text}"));
    assert_eq!(failures(&report), [(Check::Polarity, repel)]);
    assert!(check_text("pair.toml", &text.replace("-x", "+x")).passed());
}

#[test]
fn what_hangs_on_a_repelling_block_is_not_too_heavy() {
    // The post on the right repels the beam, which would then hang on the left post alone.
    let text = "blocks = [\n\
                { name = \"left\", type = \"1x1x1\", at = [0, 0, 0], axes = \"+x +y\" },\n\
                { name = \"right\", type = \"1x1x1\", at = [3, 0, 0], axes = \"+x -y\" },\n\
                { name = \"beam\", type = \"4x1x1\", at = [0, 0, 1], axes = \"+x +y\" },\n]";
    let report = check_text("bridge.toml", text);
    let failed: Vec<Check> = failures(&report).into_iter().map(|(check, _)| check).collect();
    assert_eq!(failed, [Check::Polarity], "{report:?}");
    assert!(check_text("bridge.toml", &text.replace("-y", "+y")).passed());
}

#[test]
fn blocks_without_axes_are_not_told_to_leave_them_out() {
    // Crossed slabs held by a beam and a tile: no rotations fit. A 3x2x1 that lies across another one has an odd
    // permutation of its axes and needs one different sign, but along every axis the two touch each other or a third
    // block, and so share the sign.
    let blocks = "{ name = \"a\", type = \"3x2x1\", at = [0, 0, 0], size = [3, 2, 1] },\n\
                  { name = \"b\", type = \"3x2x1\", at = [0, 2, 0], size = [2, 3, 1] },\n\
                  { name = \"c\", type = \"4x1x1\", at = [-1, 0, 0], size = [1, 4, 1] },\n\
                  { name = \"d\", type = \"2x2x1\", at = [0, 1, 1], size = [2, 2, 1] }";
    let advice = |more: &str| {
        let report = check_text("slabs.toml", &format!("blocks = [\n{blocks}{more}\n]"));
        let error = report.blueprint.unwrap_err().to_string();
        error.rsplit_once("; ").map(|(_, advice)| advice.to_owned()).unwrap()
    };
    assert_eq!(advice(""), "no turns let all blocks attract, so move one, or let it lie another way with `size`");
    let turned = ",\n{ name = \"e\", type = \"1x1x1\", at = [0, 1, 2], axes = \"+x +y\" }";
    assert_eq!(advice(turned), "move one, or leave out the `axes` of the blocks around them");
}

/// A cube between two slabs that a beam joins, and eleven blocks that can be placed at any time.
const TRAP: &str = r#"
blocks = [
{ name = "C", type = "4x1x1", at = [1,-1,0], size = [4,1,1] },
{ name = "X", type = "3x2x1", at = [0,0,0], size = [3,2,1] },
{ name = "Y", type = "3x2x1", at = [4,0,0], size = [3,2,1] },
{ name = "m", type = "1x1x1", at = [3,0,0] },
{ name = "L1", type = "2x1x1", at = [0,2,0], size = [1,2,1] },
{ name = "L2", type = "3x1x1", at = [2,2,0], size = [1,3,1] },
{ name = "L3", type = "2x1x1", at = [4,2,0], size = [1,2,1] },
{ name = "L4", type = "3x1x1", at = [6,2,0], size = [1,3,1] },
{ name = "L5", type = "2x1x1", at = [-2,1,0], size = [2,1,1] },
{ name = "L6", type = "2x1x1", at = [7,1,0], size = [2,1,1] },
{ name = "L7", type = "1x1x1", at = [0,-1,0] },
{ name = "L8", type = "1x1x1", at = [6,-1,0] },
{ name = "L9", type = "2x2x1", at = [1,-3,0], size = [2,2,1] },
{ name = "L10",type = "4x1x1", at = [4,-5,0], size = [1,4,1] },
{ name = "L11",type = "1x1x1", at = [5,0,1] },
{ name = "L12",type = "2x2x1", at = [0,0,1], size = [2,2,1] },
]
"#;

/// A slab between two beams, listed before them.
const UNORDERED: &str = r#"
blocks = [
{ name = "C", type = "3x2x1", at = [0,-3,0], size = [2,3,1] },
{ name = "m", type = "2x2x1", at = [0,0,0], size = [2,2,1] },
{ name = "X", type = "4x1x1", at = [-1,-2,0], size = [1,4,1] },
{ name = "Y", type = "4x1x1", at = [2,-2,0], size = [1,4,1] },
{ name = "L1", type = "3x1x1", at = [-4,-2,0], size = [3,1,1] },
{ name = "L2", type = "3x1x1", at = [-4,0,0], size = [3,1,1] },
{ name = "L3", type = "2x2x1", at = [-2,2,0], size = [2,2,1] },
{ name = "L4", type = "1x1x1", at = [-1,-3,0] },
{ name = "L5", type = "2x1x1", at = [3,-2,0], size = [2,1,1] },
{ name = "L6", type = "1x1x1", at = [3,0,0] },
{ name = "L7", type = "2x1x1", at = [2,2,0], size = [1,2,1] },
{ name = "L8", type = "1x1x1", at = [2,-3,0] },
{ name = "L9", type = "2x1x1", at = [1,-5,0], size = [1,2,1] },
{ name = "L10",type = "3x2x1", at = [0,-3,1], size = [2,3,1] },
{ name = "L11",type = "1x1x1", at = [-1,1,1] },
{ name = "L12",type = "2x1x1", at = [2,0,1], size = [1,2,1] },
]
"#;

#[test]
fn many_independent_blocks_do_not_exhaust_the_search() {
    let report = check_text("trap.toml", TRAP);
    assert_eq!(failures(&report), []);
    assert!(Assembly::new(&report.blueprint.unwrap()).is_ok());
}

#[test]
fn the_order_of_blocks_in_a_file_does_not_matter() {
    let report = check_text("unordered.toml", UNORDERED);
    assert_eq!(failures(&report), []);
    assert!(Assembly::new(&report.blueprint.unwrap()).is_ok());
    // The completed text lists the blocks in another order.
    assert_eq!(failures(&check_text("again.toml", &report.completed.unwrap())), []);
}
