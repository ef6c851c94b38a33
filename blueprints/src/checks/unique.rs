//! The check that compares a file with others and with the catalog.

use std::collections::BTreeMap;

use super::{Check, CheckResult, Outcome, Report, check_text};
use crate::{BlueprintId, Catalog};

/// Runs every check on `(file name, text)` pairs that will form one catalog, beside the built-in one.
pub fn check_all<'a>(files: impl IntoIterator<Item = (&'a str, &'a str)>) -> Vec<Report> {
    let mut reports: Vec<_> = files.into_iter().map(|(file, text)| check_text(file, text)).collect();
    let mut by_id: BTreeMap<BlueprintId, String> = BTreeMap::new();
    let mut by_hash: BTreeMap<u64, String> = BTreeMap::new();
    for report in &mut reports {
        let outcome = match &report.blueprint {
            Err(_) => Outcome::Skipped,
            Ok(blueprint) => {
                let other = Catalog::builtin().namesake(blueprint);
                let in_catalog = other.map(|_| "the catalog has another structure with this id".to_owned());
                let by_file = by_id.get(blueprint.id()).map(|other| format!("{other} has the same id"));
                let id_taken = in_catalog.or(by_file);
                let hash = blueprint.canonical_hash();
                let shape_taken = by_hash.get(&hash).map(|other| format!("{other} is the same structure"));
                by_id.entry(blueprint.id().clone()).or_insert_with(|| report.file.clone());
                by_hash.entry(hash).or_insert_with(|| report.file.clone());
                id_taken.or(shape_taken).map_or(Outcome::Passed, |error| Outcome::Failed { error })
            }
        };
        report.results.push(CheckResult { check: Check::Unique, outcome });
    }
    reports
}
