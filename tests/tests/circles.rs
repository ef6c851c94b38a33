//! No two files of a crate depend on each other, a file and its children included: what they share has a file of its own.
//!
//! A path leads to the file that defines the item, through all re-exports. To re-export an item is no dependency, so a
//! file may do so for its children; to use the item in its own code is one.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::repository::{files, members, read, root};

/// A module, or an item in one, as its path from the root of the crate.
type Module = Vec<String>;

/// The text of every file of a crate.
type Sources = BTreeMap<Module, String>;

/// The items that a file re-exports, by name, and what it uses.
struct Names {
    exports: BTreeMap<String, Module>,
    uses: Vec<Module>,
}

/// The module of a source file, from its path relative to `src`.
fn module(path: &Path) -> Module {
    let path = path.with_extension("");
    let names = path.iter().map(|name| name.to_string_lossy().into_owned());
    names.filter(|name| !["mod", "lib", "main"].contains(&name.as_str())).collect()
}

fn is_name(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// The words and signs of a file, without comments and without the unit tests at its end.
fn tokens(text: &str) -> Vec<String> {
    let code = text.split("mod tests {").next().unwrap_or_default();
    let code: Vec<&str> = code.lines().map(|line| line.split("//").next().unwrap_or_default()).collect();
    let apart = |c: char| if is_name(c) { c.to_string() } else { format!(" {c} ") };
    let spaced: String = code.join(" ").chars().map(apart).collect();
    spaced.replace(":  :", "::").split_whitespace().map(str::to_owned).collect()
}

/// The paths in a `use`, each with its new name, if it has one, as the last part.
fn imports(tokens: &[String]) -> Vec<Module> {
    let (mut found, mut outer, mut path) = (Vec::new(), Vec::new(), Module::new());
    for token in tokens {
        match token.as_str() {
            "::" | "as" => {}
            "{" => outer.push(path.clone()),
            "," | "}" | ";" => {
                let before = outer.last().cloned().unwrap_or_default();
                found.extend((path.len() > before.len()).then_some(path));
                path = before;
                if token == "}" {
                    outer.pop();
                }
            }
            name => path.push(name.to_owned()),
        }
    }
    found
}

/// A path in the file of `module`, from the root of the crate; `None` for a path into another crate, and for a mere name.
fn absolute(module: &Module, path: &Module, sources: &Sources) -> Option<Module> {
    let n_up = path.iter().take_while(|name| *name == "super").count();
    let base = match path[0].as_str() {
        _ if path.len() == 1 => return None,
        "crate" => &[],
        "super" | "self" => &module[..module.len().saturating_sub(n_up)],
        _ => sources.contains_key(&[&module[..], &path[..1]].concat()).then_some(&module[..])?,
    };
    let names = path.iter().filter(|name| !["crate", "super", "self"].contains(&name.as_str())).cloned();
    Some(base.iter().cloned().chain(names).collect())
}

/// Reads what the file of `module` names.
fn names(module: &Module, sources: &Sources) -> Names {
    let tokens = tokens(&sources[module]);
    let mut exports = Vec::new();
    let mut uses = Vec::new();
    let mut rest = &tokens[..];
    while let Some(first) = rest.first() {
        let before = &tokens[..tokens.len() - rest.len()];
        let comes_after = |signs: &[&str]| before.last().is_some_and(|last| signs.contains(&last.as_str()));
        let mut len = 1;
        if first == "use" && rest[1] != "<" {
            len = rest.iter().position(|token| token == ";").map_or(1, |len| len + 1);
            if comes_after(&["pub", ")"]) { &mut exports } else { &mut uses }.extend(imports(&rest[1..len]));
        } else if first.starts_with(is_name) {
            let is_more = |pair: &&[String]| pair[0] == "::" && pair[1].starts_with(is_name);
            len += 2 * rest[1..].chunks_exact(2).take_while(is_more).count();
            let is_visibility = before.ends_with(&["(".to_owned(), "in".to_owned()]);
            if !is_visibility && !comes_after(&["::", ".", "mod"]) {
                uses.push(rest[..len].iter().step_by(2).cloned().collect());
            }
        }
        rest = &rest[len..];
    }
    let exports: BTreeMap<String, Module> =
        exports.iter().filter_map(|path| Some((path.last()?.clone(), absolute(module, path, sources)?))).collect();
    let used = |path: &Module| exports.get(&path[0]).cloned().or_else(|| absolute(module, path, sources));
    Names { uses: uses.iter().filter_map(used).collect(), exports }
}

/// The module whose file defines the item.
fn home(path: &[String], names: &BTreeMap<&Module, Names>) -> Option<Module> {
    let len = (0..=path.len()).rev().find(|len| names.contains_key(&path[..*len].to_vec()))?;
    let (module, rest) = path.split_at(len);
    match rest.first().and_then(|name| names[&module.to_vec()].exports.get(name)) {
        Some(export) => home(&[export, &rest[1..]].concat(), names),
        None => Some(module.to_vec()),
    }
}

/// The dependencies of files that lead back to the file.
fn circles(sources: &Sources) -> Vec<String> {
    let names: BTreeMap<&Module, Names> = sources.keys().map(|module| (module, names(module, sources))).collect();
    let homes = |file: &Names| file.uses.iter().filter_map(|path| home(path, &names)).collect::<BTreeSet<_>>();
    let needs: BTreeMap<&Module, BTreeSet<Module>> =
        names.iter().map(|(module, file)| (*module, homes(file))).collect();
    let leads_to = |from: &Module, to: &Module| {
        let mut open = vec![from];
        let mut seen = BTreeSet::from([from]);
        while let Some(next) = open.pop() {
            open.extend(needs[next].iter().filter(|need| seen.insert(*need)));
        }
        seen.contains(to)
    };
    let all = needs.iter().flat_map(|(from, needs)| needs.iter().map(move |to| (*from, to)));
    let back = all.filter(|(from, to)| from != to && leads_to(to, from));
    back.map(|(from, to)| format!("{} → {}", from.join("::"), to.join("::"))).collect()
}

#[test]
fn no_crate_has_a_circle_of_files() {
    for member in members() {
        let src = root().join(&member).join("src");
        // In reverse, so that lib.rs replaces main.rs, which is a crate of its own.
        let sources = files(&src, &["rs"]).into_iter().rev().map(|path| {
            let inside = path.strip_prefix(&src).expect("the file was found there");
            (module(inside), read(&path))
        });
        let sources: Sources = sources.filter(|(module, _)| module.iter().all(|name| name != "tests")).collect();
        assert_eq!(circles(&sources), Vec::<String>::new(), "{member} has files that need each other");
    }
}

#[test]
fn circles_are_seen_through_reexports_and_between_a_file_and_its_children() {
    let circles = |files: &[(&str, &str)]| {
        let source = |(path, text): &(&str, &str)| (module(Path::new(path)), (*text).to_owned());
        circles(&files.iter().map(source).collect())
    };
    let lib = ("lib.rs", "mod a; mod b; pub use a::A; pub(crate) use b::{c, B as Renamed};");
    let b = ("b.rs", "use crate::A; pub struct B(A);");
    assert_eq!(circles(&[lib, ("a.rs", "fn f() -> crate::Renamed {}"), b]), ["a → b", "b → a"]);
    assert!(circles(&[lib, ("a.rs", "pub struct A; mod tests { use crate::Renamed; }"), b]).is_empty());
    // The parent re-exports what one child defines and another one uses.
    let (c, d) = (("a/c.rs", "use super::{D, d};"), ("a/d.rs", "pub(in crate::a) struct D;"));
    assert!(circles(&[("a.rs", "mod c; mod d; pub use c::C; pub use d::D;"), c, d]).is_empty());
    let (c, circle) = (("a/c.rs", "use super::P;"), ["a → a::c", "a::c → a"]);
    assert_eq!(circles(&[("a.rs", "mod c; use c::C; struct P;"), c]), circle);
    assert_eq!(circles(&[("a.rs", "pub use c::C; struct P(C);"), c]), circle);
}
