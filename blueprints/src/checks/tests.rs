//! Tests of single checks on blueprints made for them.

use super::*;
use crate::assembly::tests::jack;

#[test]
fn assembly_error_names_the_unplaced_blocks() {
    // No file can isolate this failure: a structure that cannot be assembled is also too weak for its magnets.
    let placements = jack();
    let inventory = Inventory::standard();
    let id: BlueprintId = "7_999".parse().unwrap();
    let draft = Draft::of_placements(id, Split::Train, "jack".to_owned(), &placements, inventory);
    let error = Structure::new(&draft, &placements, inventory).assembly().unwrap_err();
    let BlueprintError::NoAssembly { blocks } = &error else { panic!("{error}") };
    assert!(!blocks.is_empty() && blocks.iter().all(|name| draft.blocks.iter().any(|b| b.name == *name)), "{error}");
}
