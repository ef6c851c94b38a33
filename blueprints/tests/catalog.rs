//! The built-in catalog, and the errors of loading one.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use blueprints::catalog::BUILTIN_FILES;
use blueprints::checks::{Check, Outcome, check_all};
use blueprints::stance::{MIN_SUPPORT_MARGIN_U, support_margin_u};
use blueprints::{BlockIdx, Blueprint, BlueprintId, Catalog, Inventory, RelativePlacement, Split};
use proptest::prelude::*;

/// Id, number of links, and canonical hash of every built-in blueprint, one per line. A change here changes the
/// training set.
const GOLDEN: &str = include_str!("golden/catalog.txt");

fn id(text: &str) -> BlueprintId {
    text.parse().expect("tests name valid ids")
}

#[test]
fn builtin_catalog_matches_the_golden_file() {
    let line = |b: &Blueprint| format!("{} {} {:016x}\n", b.id(), b.links().len(), b.canonical_hash());
    let found: String = Catalog::builtin().iter().map(line).collect();
    assert_eq!(found, GOLDEN, "{found}");
}

#[test]
fn builtin_catalog_has_the_expected_sizes() {
    let counts = |split| {
        let mut counts = BTreeMap::new();
        for blueprint in Catalog::builtin().of_split(split) {
            *counts.entry(blueprint.n_blocks()).or_insert(0) += 1;
        }
        counts.into_iter().collect::<Vec<_>>()
    };
    // Table 2_0 of the paper, which sums to 142; its text says 141.
    let train = [14, 31, 36, 5, 9, 6, 6, 6, 5, 4, 4, 3, 5, 4, 4];
    assert_eq!(train.iter().sum::<i32>(), 142);
    assert_eq!(counts(Split::Train), (2..=16).zip(train).collect::<Vec<_>>());
    assert_eq!(counts(Split::Test), [12, 13, 14, 15, 16].map(|n| (n, 2)));
    assert_eq!(counts(Split::TestLiteral), [10, 12, 14, 16].map(|n| (n, 1)));
    assert_eq!(counts(Split::TestLongest), [12, 13, 14, 15, 16].map(|n| (n, 1)));
    assert_eq!(counts(Split::TestTallest), [12, 13, 14, 15, 16].map(|n| (n, 1)));
    assert_eq!(Split::PAPER.iter().map(|&split| Catalog::builtin().of_split(split).len()).sum::<usize>(), 142 + 24);
    // Not in the paper.
    let validation = [2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 3, 3, 3, 3, 2];
    assert_eq!(validation.iter().sum::<i32>(), 34);
    assert_eq!(counts(Split::Validation), (2..=16).zip(validation).collect::<Vec<_>>());
    // The paper's single-blueprint runs.
    for name in ["6_005", "12_000", "16_001"] {
        assert!(Catalog::builtin().get(&id(name)).is_some(), "{name}");
    }
    assert_eq!(Catalog::builtin().get(&id("2_999")), None);
}

#[test]
fn no_two_splits_share_an_outline() {
    let catalog = Catalog::builtin();
    assert!(catalog.of_split(Split::Train).iter().all(|blueprint| catalog.is_for_training(blueprint)));
    let held_out: Vec<_> = catalog.iter().filter(|blueprint| blueprint.split() != Split::Train).collect();
    let outlines: BTreeSet<u64> = held_out.iter().map(|blueprint| blueprint.outline_hash()).collect();
    assert_eq!(outlines.len(), held_out.len());
}

#[test]
fn builtin_files_pass_every_check() {
    for report in check_all(BUILTIN_FILES.iter().copied()) {
        assert!(report.passed(), "{report:#?}");
        assert_eq!(report.results.len(), Check::ALL.len());
    }
}

#[test]
fn builtin_blueprints_keep_the_invariants() {
    for blueprint in Catalog::builtin().iter() {
        check_invariants(blueprint);
        assert!(support_margin_u(blueprint.placements()) >= MIN_SUPPORT_MARGIN_U);
        let lowest = blueprint.placements().iter().flat_map(|p| p.filled_cells());
        assert_eq!(lowest.map(|cell| cell[2]).min(), Some(0));
    }
}

#[test]
fn two_block_set_uses_every_type_and_the_catalog_every_rotation() {
    let two: Vec<_> = Catalog::builtin().iter().filter(|b| b.n_blocks() == 2).collect();
    for block_type in Inventory::standard().types() {
        let of_type = |b: BlockIdx| Inventory::standard().block_type(b) == block_type;
        assert!(two.iter().any(|b| b.placements().iter().any(|p| of_type(p.block))), "{}", block_type.name);
    }
    let all = Catalog::builtin().iter().flat_map(Blueprint::placements);
    assert_eq!(all.map(|p| p.rotation).collect::<BTreeSet<_>>().len(), 24);
}

/// Checks the invariants of the type: sorted, linked exactly where magnets attract, no repulsion, no shared cell.
fn check_invariants(blueprint: &Blueprint) {
    let inventory = Inventory::standard();
    let placements = blueprint.placements();
    assert!(placements.is_sorted_by(|a, b| a.block < b.block));
    assert!(blueprint.links().is_sorted_by(|p, q| (p.a, p.b) < (q.a, q.b)));
    for (i, a) in placements.iter().enumerate() {
        assert_eq!(blueprint.placement(a.block), Some(a));
        for b in &placements[i + 1..] {
            let relative = RelativePlacement::between(a, b);
            assert_eq!(blueprint.relative(a.block, b.block), Some(relative));
            assert_eq!(inventory.clashing_pairs(a.block, b.block, relative), []);
            let n_pairs = inventory.magnet_pairs(a.block, b.block, relative).len();
            let link = blueprint.link(b.block, a.block);
            assert_eq!(link.map_or(0, |link| usize::from(link.n_magnet_pairs)), n_pairs);
            assert!(link.is_none_or(|link| link.relative == relative && (link.a, link.b) == (a.block, b.block)));
            let cells = a.filled_cells();
            assert!(b.filled_cells().iter().all(|cell| !cells.contains(cell)));
        }
    }
}

/// Generates permutations of the 16 blocks that preserve types.
fn permutation() -> impl Strategy<Value = [BlockIdx; 16]> {
    let shuffled = |name: &str| Just(Inventory::standard().blocks_of_type(name)).prop_shuffle();
    let types: Vec<_> = Inventory::standard().types().iter().map(|t| shuffled(t.name)).collect();
    types.prop_map(|types| types.concat().try_into().expect("the types have 16 blocks"))
}

proptest! {
    #[test]
    fn permuting_blocks_of_a_type_keeps_a_blueprint_valid(permutation in permutation()) {
        for blueprint in Catalog::builtin().iter() {
            let permuted = blueprint.permuted(&permutation);
            check_invariants(&permuted);
            prop_assert_eq!(permuted.canonical_hash(), blueprint.canonical_hash());
            for link in blueprint.links() {
                let (a, b) = (permutation[link.a.get()], permutation[link.b.get()]);
                prop_assert_eq!(permuted.relative(a, b), Some(link.relative));
            }
        }
    }
}

fn builtin_text(name: &str) -> &'static str {
    BUILTIN_FILES.iter().find(|(file, _)| *file == name).expect("tests name built-in files").1
}

#[test]
fn duplicates_split_overlaps_and_misnamed_files_are_refused() {
    let post = builtin_text("2_005.toml");
    let renamed = post.replace("2_005", "2_100");
    let held_out = renamed.replace("\"train\"", "\"test\"").replace("2_100", "test_2_000");
    let check = |files: &[(&str, &str)], expected: &str| {
        let error = Catalog::from_files(files.iter().copied()).expect_err(expected);
        assert_eq!(error.to_string(), expected);
    };
    check(&[("2_005.toml", post), ("b/2_005.toml", post)], "b/2_005.toml: the id 2_005 is taken by another file");
    check(&[("2_005.toml", post), ("2_100.toml", &renamed)], "2_100.toml: 2_100 is the same structure as 2_005");
    check(
        &[("2_005.toml", post), ("test_2_000.toml", &held_out)],
        "test_2_000.toml: test_2_000 (test) is the same structure as 2_005 (train); training would see a test",
    );
    check(&[("post.toml", post)], "post.toml: the file of blueprint 2_005 must be called 2_005.toml");
    let report = &check_all([("2_005.toml", post), ("2_100.toml", &renamed)])[1];
    let last = report.results.last().expect("every report has results");
    let error = "2_005.toml is the same structure".to_owned();
    assert_eq!((last.check, &last.outcome), (Check::Unique, &Outcome::Failed { error }));
}

#[test]
fn blueprints_of_ones_own_take_the_place_of_their_like() {
    let renamed = builtin_text("6_005.toml").replace("6_005", "6_900");
    let own = Catalog::from_files([("6_900.toml", renamed.as_str())]).expect("the file is valid");
    let both = Catalog::builtin().with(&own);
    assert_eq!(both.len(), Catalog::builtin().len());
    assert!(both.get(&id("6_005")).is_none(), "the same structure under another name");
    assert_eq!(both.get(&id("6_900")), own.get(&id("6_900")));
    assert_eq!(both.with(&both), both);
}

#[test]
fn folder_loads_like_the_builtin_catalog() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("catalog");
    assert_eq!(Catalog::load(&folder).expect("the folder is valid"), **Catalog::builtin());
    let one = Catalog::load(&folder.join("6_005.toml")).expect("the file is valid");
    assert_eq!((one.len(), one.is_empty()), (1, false));
}
