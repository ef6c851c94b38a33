//! Arbitrary text as a blueprint file: the checks never panic, and every accepted file survives a round trip.
#![no_main]

use blueprints::checks::check_text;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let report = check_text("fuzzed.toml", text);
    assert_eq!(report.passed(), report.blueprint.is_ok(), "the results and the blueprint disagree");
    let Ok(blueprint) = report.blueprint else { return };
    let written = blueprint.to_toml("fuzzed");
    assert_eq!(check_text("written.toml", &written).blueprint.as_ref(), Ok(&blueprint), "{written}");
});
