//! The starting set, and what the catalogue refuses.

use std::collections::BTreeMap;
use std::path::Path;

use blueprints::catalogue::{BUILTIN_FILES, read_files};
use blueprints::checks::{Check, Outcome, check_all};
use blueprints::stance::{MIN_SUPPORT_MARGIN_U, stance};
use blueprints::{BlockIdx, Blueprint, BlueprintId, Catalogue, CatalogueError, Inventory, RelativePlacement, Split};
use proptest::prelude::*;

/// Id, number of links and canonical hash of every built-in blueprint: a change here changes what was trained on.
const GOLDEN: &[(&str, usize, u64)] = &[
    ("2_000", 1, 0xd9a4_6a71_aca7_6d04),
    ("2_001", 1, 0xda11_8551_b193_4f95),
    ("2_002", 1, 0x7bda_9af1_aa51_d9bf),
    ("2_003", 1, 0x74db_0668_ea26_ea45),
    ("2_004", 1, 0xf941_2fe7_9e93_1eea),
    ("2_005", 1, 0x9fe9_cf5b_ddc1_b886),
    ("2_006", 1, 0xf5f1_e3b3_076c_7fb5),
    ("2_007", 1, 0x97a8_0dc4_f04b_0026),
    ("2_008", 1, 0x244d_9cb8_d8ab_a8b9),
    ("2_009", 1, 0xcafa_b3fb_43ba_d1a3),
    ("2_010", 1, 0x3dcd_dc2d_eece_56ca),
    ("2_011", 1, 0x68d3_a2dd_b9e1_4976),
    ("2_012", 1, 0x4c62_26af_299f_6668),
    ("2_013", 1, 0xe5d8_deff_c528_d123),
    ("3_000", 2, 0x9ad8_8d11_3c69_6214),
    ("3_001", 2, 0xf91c_7b62_69ab_ef57),
    ("3_002", 2, 0xb451_3ff3_7578_d68c),
    ("3_003", 2, 0x0e05_c7cd_ce7c_544f),
    ("3_004", 2, 0x6034_c249_31c0_1367),
    ("3_005", 2, 0xced8_6ffc_5546_ee94),
    ("4_000", 3, 0x149c_08c9_bdaa_b17a),
    ("4_001", 3, 0x07ac_48ad_a13b_f6ae),
    ("4_002", 4, 0x8921_e91a_0cb0_d88e),
    ("4_003", 3, 0x04af_32bf_80f6_9f8f),
    ("4_004", 4, 0xeaea_9c25_cfb7_006f),
    ("4_005", 3, 0x2803_1a03_5cb6_29fd),
    ("6_000", 6, 0x56fe_8501_bb76_e608),
    ("6_005", 7, 0xaf41_1c67_5e49_7f63),
    ("8_000", 7, 0x5449_a53a_3961_b8b0),
    ("8_001", 9, 0xbf98_74b2_7135_a3d9),
    ("12_000", 17, 0x9b23_70bf_5901_972c),
    ("12_001", 19, 0x47cd_f186_a531_3f72),
    ("16_000", 21, 0x8eb6_41af_f47b_0706),
    ("16_001", 17, 0x97b3_020a_e536_ce13),
];

fn id(text: &str) -> BlueprintId {
    text.parse().expect("tests name valid ids")
}

#[test]
fn the_builtin_set_is_the_golden_one() {
    let found: Vec<_> =
        Catalogue::builtin().iter().map(|b| (b.id().as_str(), b.links().len(), b.canonical_hash())).collect();
    assert_eq!(found, GOLDEN, "{found:#x?}");
}

#[test]
fn the_builtin_set_has_the_wanted_sizes() {
    let mut counts = BTreeMap::new();
    for blueprint in Catalogue::builtin().of_split(Split::Train) {
        *counts.entry(blueprint.n_blocks()).or_insert(0) += 1;
    }
    assert_eq!(counts, BTreeMap::from([(2, 14), (3, 6), (4, 6), (6, 2), (8, 2), (12, 2), (16, 2)]));
    // The paper's single-blueprint runs.
    for name in ["6_005", "12_000", "16_001"] {
        assert!(Catalogue::builtin().get(&id(name)).is_some(), "{name}");
    }
    assert_eq!(Catalogue::builtin().get(&id("2_999")), None);
}

#[test]
fn every_file_passes_every_check() {
    for report in check_all(BUILTIN_FILES.iter().copied()) {
        assert!(report.passed(), "{report:#?}");
        assert_eq!(report.results.len(), Check::ALL.len());
    }
}

#[test]
fn every_blueprint_stands_on_the_ground_in_one_piece_of_distinct_blocks() {
    for blueprint in Catalogue::builtin().iter() {
        check_invariants(blueprint);
        assert!(stance(blueprint.placements(), Inventory::standard()).margin_u >= MIN_SUPPORT_MARGIN_U);
        let lowest = blueprint.placements().iter().flat_map(|p| p.filled_cells(Inventory::standard()));
        assert_eq!(lowest.map(|cell| cell[2]).min(), Some(0));
    }
}

#[test]
fn the_two_block_set_uses_every_type_and_the_whole_set_every_rotation() {
    let two: Vec<_> = Catalogue::builtin().iter().filter(|b| b.n_blocks() == 2).collect();
    for block_type in Inventory::standard().types() {
        let of_type = |b: BlockIdx| Inventory::standard().block_type(b) == block_type;
        assert!(two.iter().any(|b| b.placements().iter().any(|p| of_type(p.block))), "{}", block_type.name);
    }
    let all = Catalogue::builtin().iter().flat_map(Blueprint::placements);
    assert_eq!(all.map(|p| p.rotation).collect::<std::collections::BTreeSet<_>>().len(), 24);
}

/// What the type promises: sorted and linked exactly where magnets attract, nothing repelling, no shared cell.
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
            let cells = a.filled_cells(inventory);
            assert!(b.filled_cells(inventory).iter().all(|cell| !cells.contains(cell)));
        }
    }
}

/// A permutation of the 16 blocks that keeps the types.
fn permutation() -> impl Strategy<Value = [BlockIdx; 16]> {
    let shuffled = |name: &str| Just(Inventory::standard().blocks_of_type(name)).prop_shuffle();
    let types: Vec<_> = Inventory::standard().types().iter().map(|t| shuffled(&t.name)).collect();
    types.prop_map(|types| types.concat().try_into().expect("the types have 16 blocks"))
}

proptest! {
    #[test]
    fn permuting_equal_blocks_keeps_a_blueprint_valid(permutation in permutation()) {
        for blueprint in Catalogue::builtin().iter() {
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
fn duplicates_overlaps_of_splits_and_misnamed_files_are_refused() {
    let post = builtin_text("2_005.toml");
    let renamed = post.replace("2_005", "2_100");
    let held_out = renamed.replace("\"train\"", "\"test\"").replace("2_100", "test_2_000");
    let check = |files: &[(&str, &str)], expected: &str| {
        let error = Catalogue::from_files(files.iter().copied()).expect_err(expected);
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
fn a_folder_loads_like_the_builtin_set() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("catalogue");
    assert_eq!(Catalogue::load(&folder).expect("the folder is valid"), *Catalogue::builtin());
    let one = Catalogue::load(&folder.join("6_005.toml")).expect("the file is valid");
    assert_eq!((one.len(), one.is_empty()), (1, false));
    let without = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    assert!(matches!(Catalogue::load(&without), Err(CatalogueError::Empty(path)) if path == without));
    let missing = folder.join("nowhere.toml");
    let error = read_files(&missing).expect_err("there is no such file").to_string();
    assert!(error.starts_with(&format!("cannot read {}: ", missing.display())), "{error}");
}

#[test]
fn ids_and_splits_read_back_and_refuse_other_words() {
    for good in ["2_000", "16_001", "test_12_000", "test-literal_10_000"] {
        assert_eq!(id(good).to_string(), good);
    }
    for bad in ["", "2", "2_00", "2_0000", "1_000", "17_000", "02_000", "_2_000", "Test_2_000", "2_00a", "a_b_2_000"] {
        let error = bad.parse::<BlueprintId>().expect_err(bad).to_string();
        assert!(error.starts_with(&format!("{bad:?} is not a blueprint id")), "{error}");
    }
    for split in Split::ALL {
        assert_eq!(split.to_string().parse(), Ok(split));
    }
    assert!("tset".parse::<Split>().expect_err("tset").to_string().starts_with("\"tset\" is not a split"));
}
