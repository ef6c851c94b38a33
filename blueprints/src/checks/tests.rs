//! What single checks say of blueprints made for them.

use super::*;
use crate::assembly::tests::jack;

#[test]
fn what_cannot_be_put_together_names_the_blocks_that_are_left() {
    // No file can show this alone: a structure that nobody can build is also too weak for its magnets.
    let placements = jack();
    let inventory = Inventory::standard();
    let id: BlueprintId = "7_999".parse().unwrap();
    let draft = Draft::of_placements(id, Split::Train, "jack".to_owned(), &placements, inventory);
    let error = Structure::new(&draft, &placements, inventory).assembly().unwrap_err();
    let BlueprintError::NoAssembly { blocks } = &error else { panic!("{error}") };
    assert!(!blocks.is_empty() && blocks.iter().all(|name| draft.blocks.iter().any(|b| b.name == *name)), "{error}");
}
