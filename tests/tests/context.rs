//! The context of `docker build` holds what the build reads: compares .dockerignore with the workspace's members.

use std::collections::BTreeSet;

use crate::repository::{files, members, read, root, shown};

/// The patterns of .dockerignore, and whether each lets through what the ones before it exclude.
fn patterns() -> Vec<(bool, Vec<String>)> {
    let text = read(&root().join(".dockerignore"));
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    lines.map(pattern).collect()
}

fn pattern(line: &str) -> (bool, Vec<String>) {
    let rest = line.strip_prefix('!');
    (rest.is_some(), rest.unwrap_or(line).split('/').map(str::to_owned).collect())
}

/// Whether a name matches a pattern with any number of `*`.
fn name_matches(pattern: &str, name: &str) -> bool {
    match pattern.split_once('*') {
        None => pattern == name,
        Some((start, rest)) => name.strip_prefix(start).is_some_and(|end| {
            end.char_indices().map(|(at, _)| at).chain([end.len()]).any(|at| name_matches(rest, &end[at..]))
        }),
    }
}

/// Whether a pattern matches a path or one of the folders that it lies in.
fn matches(pattern: &[String], path: &[&str]) -> bool {
    match (pattern.split_first(), path.split_first()) {
        (None, _) => true,
        (Some((first, rest)), _) if first == "**" => {
            matches(rest, path) || path.split_first().is_some_and(|(_, inside)| matches(pattern, inside))
        }
        (Some((first, rest)), Some((name, inside))) => name_matches(first, name) && matches(rest, inside),
        (Some(_), None) => false,
    }
}

/// Whether Docker sends this file, whose path is relative to the root: the last pattern that matches decides.
fn is_sent(patterns: &[(bool, Vec<String>)], path: &str) -> bool {
    let path: Vec<&str> = path.split('/').collect();
    let last = patterns.iter().rev().find(|(_, pattern)| matches(pattern, &path));
    last.is_none_or(|(lets_through, _)| *lets_through)
}

/// A path from `folder`, relative to the root.
fn from_root(folder: &str, path: &str) -> String {
    let mut parts: Vec<&str> = folder.split('/').filter(|part| !part.is_empty()).collect();
    for part in path.split('/').filter(|part| *part != ".") {
        if part == ".." {
            parts.pop().expect("the path stays in the repository");
        } else {
            parts.push(part);
        }
    }
    parts.join("/")
}

/// What the build reads of a crate: its manifest, its build script, all files below `src`, and the files that these
/// name.
fn sources(folder: &str) -> BTreeSet<String> {
    let crate_folder = root().join(folder);
    let own = ["Cargo.toml", "build.rs"].map(|name| crate_folder.join(name));
    let mut found: BTreeSet<String> = own.iter().filter(|path| path.exists()).map(|path| shown(path)).collect();
    for path in files(&crate_folder.join("src"), &["rs", "html", "js", "css", "toml", "proto"]) {
        let file = shown(&path);
        let folder = file.rsplit_once('/').map_or("", |(folder, _)| folder);
        let text = read(&path);
        for start in ["include_str!(\"", "include_bytes!(\""] {
            let included = text.split(start).skip(1).filter_map(|rest| rest.split('"').next());
            found.extend(included.map(|name| from_root(folder, name)));
        }
        found.insert(file);
    }
    found
}

#[test]
fn the_context_holds_what_the_build_reads() {
    let patterns = patterns();
    let members = members();
    let needed =
        members.iter().flat_map(|folder| sources(folder)).chain(["Cargo.toml", "Cargo.lock"].map(str::to_owned));
    let left_out: Vec<String> = needed.filter(|file| !is_sent(&patterns, file)).collect();
    assert_eq!(left_out, Vec::<String>::new(), ".dockerignore lets too little through");
}

#[test]
fn the_last_pattern_that_matches_decides() {
    let patterns = ["*", "!actor", "!tests", "tests/.env*", "**/*.md", "**/target"].map(pattern);
    for (path, expected) in [
        ("actor/src/lib.rs", true),
        ("bus/src/lib.rs", false),
        ("actor/README.md", false),
        ("actor/src/readme.mdx", true),
        ("tests/.env.example", false),
        ("tests/env", true),
        ("actor/target/debug/lodestone", false),
    ] {
        assert_eq!(is_sent(&patterns, path), expected, "{path}");
    }
}
