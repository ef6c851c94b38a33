//! The worked examples in `blueprints/examples`, and the files on the page that explains the format.

use std::collections::BTreeSet;
use std::path::Path;

use blueprints::catalog::read_files;
use blueprints::checks::{Outcome, check_all, check_text};
use blueprints::{Blueprint, Catalog};

fn examples() -> Vec<(String, String)> {
    read_files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("examples")).expect("the folder can be read")
}

#[test]
fn every_example_passes_the_checks_and_is_new() {
    let files = examples();
    let reports = check_all(files.iter().map(|(file, text)| (file.as_str(), text.as_str())));
    assert_eq!(reports.len(), 5);
    let mut sizes = BTreeSet::new();
    let known: BTreeSet<u64> = Catalog::builtin().iter().map(Blueprint::outline_hash).collect();
    for report in &reports {
        let failed: Vec<_> = report.results.iter().filter(|result| result.outcome != Outcome::Passed).collect();
        assert!(failed.is_empty(), "{}: {failed:?}", report.file);
        let blueprint = report.blueprint.as_ref().expect("all checks passed");
        assert!(!known.contains(&blueprint.outline_hash()), "{} is in the catalog", report.file);
        sizes.insert(blueprint.n_blocks());
        if let Some(completed) = &report.completed {
            assert_eq!(check_text("completed.toml", completed).blueprint.as_ref(), Ok(blueprint), "{completed}");
        }
    }
    assert_eq!(sizes, BTreeSet::from([3, 6, 8, 12]));
}

#[test]
fn a_folder_of_them_is_a_set() {
    let set = Catalog::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("examples")).expect("the folder can be read");
    let ids: Vec<&str> = set.iter().map(|blueprint| blueprint.id().as_str()).collect();
    assert_eq!(ids, ["signpost", "gate", "park-bench", "lighthouse", "castle"]);
    assert!(set.iter().all(|blueprint| Catalog::builtin().is_for_training(blueprint)));
}

#[test]
fn files_on_the_page_about_the_format_are_valid() {
    let page = include_str!("../../docs/blueprints.md");
    let files: Vec<&str> = page.split("```toml\n").skip(1).filter_map(|rest| rest.split("```").next()).collect();
    assert!(files.len() >= 2, "the page has {} files", files.len());
    for text in files {
        let report = check_text("page.toml", text);
        assert!(report.passed(), "{text}{report:?}");
    }
}
