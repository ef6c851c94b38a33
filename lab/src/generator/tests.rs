//! Generated structures: valid for every style, size, and seed; equal for equal ids; different from each other.

use std::collections::BTreeSet;

use blueprints::catalog::BUILTIN_FILES;
use blueprints::checks::check_text;
use blueprints::{Blueprint, BlueprintId, Catalog, Split};
use clap::ValueEnum;
use proptest::prelude::*;

use super::{GenerateError, MAX_INDEX, Request, Style, generate, generate_many};

/// Canonical hashes of a few structures. A change here alters all generated ids and needs a new version.
const GOLDEN: [(&str, u64); 5] = [
    ("gen1-any-0_6_000", 0xdf8b_a3cf_f900_3ea0),
    ("gen1-any-0_16_000", 0x626e_e54d_5842_a2d3),
    ("gen1-arch-beef_9_007", 0x60b1_89e7_8f38_a154),
    ("gen1-letter-ffffffffffffffff_12_999", 0xcf82_2a49_fa43_6635),
    ("gen1-tallest-2_16_007", 0x48be_7eb0_6e31_0e85),
];

fn id(text: &str) -> BlueprintId {
    text.parse().expect("tests name valid ids")
}

/// Generates the structure that an id names.
fn made(id: &BlueprintId) -> Option<Blueprint> {
    generate(&Request::from_id(id)?).ok()
}

/// Checks the guarantees of every generated blueprint.
fn check(request: &Request) -> Blueprint {
    let blueprint = generate(request).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((blueprint.n_blocks(), blueprint.split()), (request.n_blocks, Split::Train));
    assert_eq!(Request::from_id(blueprint.id()), Some(*request));
    let text = blueprint.to_toml(&request.provenance());
    assert_eq!(check_text("generated.toml", &text).blueprint.as_ref(), Ok(&blueprint), "{text}");
    blueprint
}

#[test]
fn every_style_and_size_is_valid_and_varies_with_the_seed() {
    let (mut n_same, mut n_all) = (0, 0);
    for &style in Style::value_variants() {
        for n_blocks in style.sizes() {
            let one = check(&Request { style, seed: 1, n_blocks, index: 0 });
            let other = generate(&Request { style, seed: 2, n_blocks, index: 0 }).expect("it is found");
            n_same += usize::from(one.canonical_hash() == other.canonical_hash());
            n_all += 1;
        }
    }
    assert!(20 * n_same < n_all, "{n_same} of {n_all}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn equal_requests_give_equal_valid_blueprints(
        style in prop::sample::select(Style::value_variants()),
        seed in any::<u64>(),
        n_blocks in 2_usize..=16,
        index in 0..=MAX_INDEX,
    ) {
        let n_blocks = n_blocks.max(*style.sizes().start());
        let blueprint = check(&Request { style, seed, n_blocks, index });
        prop_assert_eq!(made(blueprint.id()), Some(blueprint));
    }
}

#[test]
fn generated_structures_are_pinned() {
    let found: Vec<_> = GOLDEN.iter().map(|&(name, _)| (name, made(&id(name)).expect(name).canonical_hash())).collect();
    assert_eq!(found, GOLDEN, "{found:#x?}");
}

#[test]
fn catalog_records_match_their_provenance() {
    for (file, generated) in [
        ("longest_12_000", "gen1-longest-3_12_003"),
        ("longest_13_000", "gen1-longest-3_13_000"),
        ("longest_14_000", "gen1-longest-4_14_001"),
        ("longest_15_000", "gen1-longest-1_15_000"),
        ("longest_16_000", "gen1-longest-20_16_021"),
        ("tallest_12_000", "gen1-tallest-15_12_109"),
        ("tallest_13_000", "gen1-tallest-17_13_065"),
        ("tallest_14_000", "gen1-tallest-16_14_162"),
        ("tallest_15_000", "gen1-tallest-1f_15_153"),
        ("tallest_16_000", "gen1-tallest-1a_16_048"),
    ] {
        let kept = Catalog::builtin().get(&id(file)).expect(file);
        let made = made(&id(generated)).expect(generated);
        assert_eq!((kept.placements(), kept.links()), (made.placements(), made.links()), "{file}");
        assert_eq!(kept.title(), made.title());
        assert!(matches!(kept.split(), Split::TestLongest | Split::TestTallest), "{file}");
    }
}

/// These requests generated the validation split: two or three styles for each size, index 0, and the first seed from
/// 24 on whose structure passes the checks of `lodestone blueprints check`, including those in a simulated world.
#[test]
fn validation_goals_match_their_provenance_and_are_not_for_training() {
    let catalog = Catalog::builtin();
    let drawn = [
        ("validation_2_000", "gen1-any-19_2_000"),
        ("validation_2_001", "gen1-tower-18_2_000"),
        ("validation_3_000", "gen1-any-18_3_000"),
        ("validation_3_001", "gen1-tower-18_3_000"),
        ("validation_4_000", "gen1-any-18_4_000"),
        ("validation_4_001", "gen1-ring-18_4_000"),
        ("validation_5_000", "gen1-table-18_5_000"),
        ("validation_5_001", "gen1-stairs-18_5_000"),
        ("validation_6_000", "gen1-arch-18_6_000"),
        ("validation_6_001", "gen1-cross-18_6_000"),
        ("validation_7_000", "gen1-arch-18_7_000"),
        ("validation_7_001", "gen1-stairs-18_7_000"),
        ("validation_8_000", "gen1-table-19_8_000"),
        ("validation_8_001", "gen1-ring-18_8_000"),
        ("validation_9_000", "gen1-tower-18_9_000"),
        ("validation_9_001", "gen1-cross-18_9_000"),
        ("validation_10_000", "gen1-bridge-18_10_000"),
        ("validation_10_001", "gen1-pyramid-18_10_000"),
        ("validation_11_000", "gen1-wall-18_11_000"),
        ("validation_11_001", "gen1-letter-18_11_000"),
        ("validation_12_000", "gen1-any-1a_12_000"),
        ("validation_12_001", "gen1-bridge-18_12_000"),
        ("validation_12_002", "gen1-tallest-23_12_000"),
        ("validation_13_000", "gen1-arch-18_13_000"),
        ("validation_13_001", "gen1-pyramid-18_13_000"),
        ("validation_13_002", "gen1-longest-18_13_000"),
        ("validation_14_000", "gen1-tower-18_14_000"),
        ("validation_14_001", "gen1-stairs-18_14_000"),
        ("validation_14_002", "gen1-letter-18_14_000"),
        ("validation_15_000", "gen1-wall-18_15_000"),
        ("validation_15_001", "gen1-table-18_15_000"),
        ("validation_15_002", "gen1-ring-19_15_000"),
        ("validation_16_000", "gen1-cross-29_16_000"),
        ("validation_16_001", "gen1-longest-1b_16_000"),
    ];
    assert_eq!(drawn.len(), catalog.of_split(Split::Validation).len());
    let mut styles = BTreeSet::new();
    for (file, generated) in drawn {
        let kept = catalog.get(&id(file)).expect(file);
        let made = made(&id(generated)).expect(generated);
        assert_eq!((kept.placements(), kept.links()), (made.placements(), made.links()), "{file}");
        assert_eq!((kept.title(), kept.split()), (made.title(), Split::Validation), "{file}");
        assert!(!catalog.is_for_training(&made), "{generated}");
        let request = Request::from_id(made.id()).expect(generated);
        let text = BUILTIN_FILES.iter().find(|(name, _)| *name == format!("{file}.toml")).expect(file).1;
        assert!(text.contains(&format!("provenance = \"{}\"\n", request.provenance())), "{text}");
        styles.insert(request.style);
    }
    assert_eq!(styles, BTreeSet::from_iter(Style::value_variants().iter().copied()), "every style");
}

#[test]
fn other_ids_are_not_generated() {
    for other in
        ["2_000", "test_12_000", "gen2-any-0_4_000", "gen1-any-00_4_000", "gen1-any-x_4_000", "gen1-nose-0_4_000"]
    {
        assert_eq!(Request::from_id(&id(other)), None, "{other}");
    }
    // A ring of two blocks.
    assert_eq!(Request::from_id(&id("gen1-ring-0_2_000")), None);
    let request = Request { style: Style::Arch, seed: 0xbeef, n_blocks: 12, index: 7 };
    assert_eq!(request.id(), Ok(id("gen1-arch-beef_12_007")));
}

#[test]
fn impossible_requests_name_the_valid_range() {
    let error = |style, n_blocks, index| {
        generate(&Request { style, seed: 0, n_blocks, index }).expect_err("it is impossible").to_string()
    };
    assert_eq!(error(Style::Ring, 3, 0), "style ring needs 4 to 16 blocks, not 3");
    assert_eq!(error(Style::Any, 17, 0), "style any needs 2 to 16 blocks, not 17");
    assert_eq!(error(Style::Any, 4, 1000), "index 1000 of a generated blueprint is not in 0..=999");
}

#[test]
fn generate_many_is_distinct_and_respects_exclusions() {
    let builtin: BTreeSet<u64> = Catalog::builtin().iter().map(Blueprint::canonical_hash).collect();
    let first = generate_many(Style::Any, 3, 2, 20, &builtin).expect("there are enough pairs");
    let hashes: BTreeSet<u64> = first.iter().map(Blueprint::canonical_hash).collect();
    assert_eq!((first.len(), hashes.len()), (20, 20));
    assert!(hashes.is_disjoint(&builtin));
    // Excluding these as well yields others.
    let exclude: BTreeSet<u64> = builtin.union(&hashes).copied().collect();
    let second = generate_many(Style::Any, 3, 2, 20, &exclude).expect("there are enough pairs");
    assert!(second.iter().all(|blueprint| !exclude.contains(&blueprint.canonical_hash())));
    // Each blueprint equals the one generated from its id.
    for blueprint in first.iter().chain(&second) {
        assert_eq!(made(blueprint.id()).as_ref(), Some(blueprint));
    }
    let too_many = generate_many(Style::Wall, 0, 2, 900, &BTreeSet::new());
    assert!(matches!(too_many, Err(GenerateError::TooFew { count: 900, .. })), "{too_many:?}");
}
