//! Which crates may depend on which: compares the table in ARCHITECTURE.md with the manifests.

use std::collections::{BTreeMap, BTreeSet};

use crate::repository::{files, manifest, members, read, root, shown};

/// External crates by name prefix, with the only crates that may depend on them.
const HOMES: [(&str, &[&str]); 12] = [
    ("rapier", &["environment"]),
    ("burn", &["policy", "learner", "lab"]),
    ("cubecl", &["policy", "learner"]),
    ("zenoh", &["bus"]),
    // TensorBoard's event files are protobuf, too.
    ("prost", &["proto", "runlog"]),
    ("rusqlite", &["runlog"]),
    ("openh264", &["render"]),
    ("axum", &["dashboard"]),
    ("clap", &["deploy", "lab"]),
    ("rcgen", &["deploy"]),
    ("ratatui", &["dashboard"]),
    ("crossterm", &["dashboard"]),
];

/// Crates whose results depend only on their arguments.
const PURE: [&str; 3] = ["blueprints", "environment", "policy"];

/// What a pure crate must not use: clocks, the network, other processes, environment variables, the terminal, and
/// global randomness.
const IMPURE: [&str; 9] = [
    "Instant::now",
    "SystemTime",
    "std::net",
    "std::process",
    "std::env::",
    "println!",
    "rand::rng(",
    "rand::random",
    "OsRng",
];

/// The rows of the table in ARCHITECTURE.md: each crate, with all crates of the workspace that it may depend on.
fn allowed() -> BTreeMap<String, Vec<String>> {
    let page = read(&root().join("ARCHITECTURE.md"));
    let rows = page.lines().filter_map(|line| line.strip_prefix("| [")?.strip_suffix(" |")?.split_once("]("));
    let row = |(member, rest): (&str, &str)| {
        let list = rest.rsplit(" | ").next().unwrap_or_default();
        (member.to_owned(), list.split(", ").map(str::to_owned).collect())
    };
    rows.map(row).collect()
}

/// All members except the tests, which may depend on everything.
fn tested() -> impl Iterator<Item = String> {
    members().into_iter().filter(|member| member != "tests")
}

/// Names of the dependencies in the given tables of a manifest, including target-specific ones.
fn dependencies(member: &str, tables: &[&str]) -> BTreeSet<String> {
    let manifest = manifest(&root().join(member).join("Cargo.toml"));
    let targets = manifest.get("target").and_then(|targets| targets.as_table());
    let scopes = targets.into_iter().flat_map(|targets| targets.values().filter_map(|target| target.as_table()));
    std::iter::once(&manifest)
        .chain(scopes)
        .flat_map(|scope| tables.iter().filter_map(|table| scope.get(*table)?.as_table()))
        .flat_map(|table| table.iter().map(|(name, spec)| package_name(name, spec)))
        .collect()
}

/// The real name of a dependency, which may be renamed.
fn package_name(name: &str, spec: &toml::Value) -> String {
    spec.get("package").and_then(|package| package.as_str()).unwrap_or(name).to_owned()
}

#[test]
fn every_member_has_a_row_in_the_table() {
    let rows: BTreeSet<String> = allowed().into_keys().collect();
    assert_eq!(rows, members().into_iter().collect());
}

#[test]
fn dependencies_point_one_way() {
    let members = members();
    for (member, allowed) in allowed() {
        for name in dependencies(&member, &["dependencies", "build-dependencies"]) {
            let edge_is_fine = !members.contains(&name) || allowed.contains(&name);
            assert!(edge_is_fine, "{member} must not depend on {name}: see ARCHITECTURE.md");
        }
    }
}

/// The crates of the workspace that `member` builds with, including itself.
fn closure(member: &str) -> BTreeSet<String> {
    let members = members();
    let mut found = BTreeSet::new();
    let mut open = vec![member.to_owned()];
    while let Some(next) = open.pop() {
        let inside = dependencies(&next, &["dependencies"]).into_iter().filter(|name| members.contains(name));
        open.extend(inside);
        found.insert(next);
    }
    found
}

#[test]
fn whoever_wants_a_world_or_a_policy_builds_no_bus() {
    for member in PURE {
        for name in closure(member).iter().flat_map(|part| dependencies(part, &["dependencies"])) {
            assert!(!["tokio", "zenoh", "bus"].contains(&name.as_str()), "{member} builds {name}");
        }
    }
}

#[test]
fn nobody_depends_on_the_tests_and_only_the_lab_on_the_binary() {
    for member in tested() {
        let all = dependencies(&member, &["dependencies", "build-dependencies", "dev-dependencies"]);
        assert!(!all.contains("tests"), "{member} must not depend on tests");
        assert!(member == "lab" || !all.contains("deploy"), "{member} must not depend on deploy");
    }
}

#[test]
fn external_crates_stay_at_home() {
    for member in tested() {
        for name in dependencies(&member, &["dependencies", "build-dependencies", "dev-dependencies"]) {
            for (prefix, homes) in HOMES {
                let is_home = homes.contains(&member.as_str());
                assert!(!name.starts_with(prefix) || is_home, "{member} names {name}, whose home is {homes:?}");
            }
        }
    }
}

#[test]
fn pure_crates_read_no_clock_and_do_no_io() {
    for member in PURE {
        for path in files(&root().join(member).join("src"), &["rs"]) {
            for (number, line) in read(&path).lines().enumerate() {
                let code = line.split("//").next().unwrap_or_default();
                let found = IMPURE.iter().find(|word| code.contains(*word));
                assert_eq!(found, None, "{}:{} is in a pure crate", shown(&path), number + 1);
            }
        }
    }
}

#[test]
fn all_members_share_lints_edition_and_license() {
    for member in members() {
        let manifest = manifest(&root().join(&member).join("Cargo.toml"));
        let inherits = |table: &toml::Value, key: &str| {
            let value = table.get(key).and_then(|value| value.get("workspace")).or_else(|| table.get(key));
            value.and_then(toml::Value::as_bool) == Some(true)
        };
        assert!(inherits(&manifest["lints"], "workspace"), "{member}: lints");
        for key in ["version", "edition", "rust-version", "license"] {
            assert!(inherits(&manifest["package"], key), "{member}: {key} is not the workspace's");
        }
    }
}
