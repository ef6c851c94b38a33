//! Files are short and finished, and links between them are valid.

use crate::repository::{files, manifest, members, read, root, shown};

/// A file has one subject; a longer one usually has two.
const MAX_LINES: usize = 600;

/// Marks of unfinished work, assembled here so that this file does not contain them.
const LEFTOVERS: [&str; 7] = [
    concat!("TO", "DO"),
    concat!("FIX", "ME"),
    concat!("X", "XX"),
    concat!("HA", "CK"),
    concat!("to", "do!"),
    concat!("unimple", "mented!"),
    concat!("db", "g!("),
];

/// Constructs that skip tests, or let them pass by luck. Clippy refuses to sleep.
const SHAKY: [&str; 2] = [concat!("#[ig", "nore"), concat!("should", "_panic")];

/// All lines in files with these extensions that contain one of `words`, as `file:line: word`.
fn hits(extensions: &[&str], words: &[&str]) -> Vec<String> {
    let mut hits = Vec::new();
    for path in files(root(), extensions) {
        for (number, line) in read(&path).lines().enumerate() {
            let found = words.iter().filter(|word| line.contains(**word));
            hits.extend(found.map(|word| format!("{}:{}: {word}", shown(&path), number + 1)));
        }
    }
    hits
}

#[test]
fn source_files_have_at_most_600_lines() {
    let long: Vec<String> = files(root(), &["rs"])
        .iter()
        .map(|path| (path, read(path).lines().count()))
        .filter(|(_, n_lines)| *n_lines > MAX_LINES)
        .map(|(path, n_lines)| format!("{}: {n_lines} lines", shown(path)))
        .collect();
    assert_eq!(long, Vec::<String>::new());
}

#[test]
fn nothing_is_left_unfinished() {
    assert_eq!(hits(&["rs", "sh", "toml", "md", "proto"], &LEFTOVERS), Vec::<String>::new());
}

#[test]
fn no_test_hides() {
    assert_eq!(hits(&["rs"], &SHAKY), Vec::<String>::new());
}

#[test]
fn every_source_file_says_what_it_is_about() {
    for member in members() {
        for path in files(&root().join(&member).join("src"), &["rs"]) {
            assert!(read(&path).starts_with("//!"), "{} does not begin with its subject", shown(&path));
        }
    }
}

#[test]
fn links_between_documents_lead_somewhere() {
    for path in files(root(), &["md"]) {
        let text = read(&path);
        let targets = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        for target in targets.filter(|target| !target.contains("://") && !target.starts_with('#')) {
            let file = target.split('#').next().unwrap_or_default();
            let folder = path.parent().expect("a file lies in a folder");
            assert!(folder.join(file).exists(), "{}: the link to {target} is broken", shown(&path));
        }
    }
}

#[test]
fn the_algorithm_for_contributors_is_one_that_compiles() {
    let page = read(&root().join("CONTRIBUTING.md"));
    let example = page.split("```rust\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
    let tested = read(&root().join("learner/src/advantages.rs"));
    let tested: Vec<&str> = tested.lines().filter_map(|line| line.strip_prefix("//!")).map(str::trim).collect();
    for line in example.lines() {
        assert!(tested.contains(&line.trim()), "the doc test of learner/src/advantages.rs does not have {line:?}");
    }
}

#[test]
fn all_files_name_the_same_version() {
    let version = |path: &str, section: &[&str]| {
        let table = toml::Value::Table(manifest(&root().join(path)));
        section.iter().fold(&table, |value, key| &value[*key])["version"].as_str().expect("a version").to_owned()
    };
    let expected = version("Cargo.toml", &["workspace", "package"]);
    assert_eq!(version("python/Cargo.toml", &["package"]), expected);
    for (file, line) in [
        ("CITATION.cff", format!("version: {expected}\n")),
        ("CHANGELOG.md", format!("## [Unreleased]\n\n## [{expected}] - ")),
        ("deploy/kubernetes/base/pod.yaml", format!("image: lodestone:{expected}\n")),
        ("deploy/kubernetes/components/gpu/learner.yaml", format!("value: lodestone-gpu:{expected}\n")),
    ] {
        assert!(read(&root().join(file)).contains(&line), "{file} does not contain {line:?}");
    }
}
