//! No two files of a crate depend on each other: code that belongs together is in one file, in a file and its children,
//! or has its common part in a file of its own.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::repository::{files, members, read, root};

/// A module, as its path from the root of the crate.
type Module = Vec<String>;

/// The module of a source file, from its path relative to `src`.
fn module(path: &Path) -> Module {
    let mut names: Module =
        path.with_extension("").components().map(|part| part.as_os_str().to_string_lossy().into_owned()).collect();
    if names.last().is_some_and(|last| ["mod", "lib", "main"].contains(&last.as_str())) {
        names.pop();
    }
    names
}

/// Source code without comments and without the unit tests at its end.
fn code(text: &str) -> String {
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    code.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// The paths in a file of `module` that begin with `crate`, `super`, or `self`, resolved from the root of the crate.
fn paths(module: &Module, code: &str) -> Vec<Module> {
    let mut found = Vec::new();
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    for start in ["crate::", "super::", "self::"].iter().flat_map(|word| code.match_indices(word)) {
        if code[..start.0].ends_with(is_name) || code[..start.0].ends_with("::") {
            continue;
        }
        let mut rest = &code[start.0..];
        let mut base = Module::new();
        if !rest.starts_with("crate::") {
            base.clone_from(module);
        }
        let mut is_first = true;
        while let Some((name, after)) = rest.split_once("::").filter(|(name, _)| name.chars().all(is_name)) {
            match name {
                "super" => drop(base.pop()),
                "crate" | "self" if is_first => {}
                name => base.push(name.to_owned()),
            }
            (rest, is_first) = (after, false);
        }
        match rest.strip_prefix('{') {
            None => found.push([base, vec![rest.chars().take_while(|c| is_name(*c)).collect()]].concat()),
            Some(list) => {
                let end = closing(list);
                let names = outermost(&list[..end]);
                found.extend(names.into_iter().map(|name| [base.clone(), name].concat()));
            }
        }
    }
    found
}

/// The index of the brace that closes the one before the list.
fn closing(list: &str) -> usize {
    let mut depth = 1;
    for (place, c) in list.char_indices() {
        depth += i32::from(c == '{') - i32::from(c == '}');
        if depth == 0 {
            return place;
        }
    }
    list.len()
}

/// The paths in a list; of nested lists, only the part before the brace.
fn outermost(list: &str) -> Vec<Module> {
    let (mut depth, mut flat) = (0, String::new());
    for c in list.chars() {
        depth += i32::from(c == '{');
        if depth == 0 {
            flat.push(c);
        }
        depth -= i32::from(c == '}');
    }
    let path = |item: &str| item.trim().split("::").filter(|name| !name.is_empty()).map(str::to_owned).collect();
    flat.split(',').filter(|item| !item.trim().is_empty()).map(path).collect()
}

/// The dependencies between siblings, for each common parent; a file and its own children may depend on each other.
fn needs(sources: &BTreeMap<Module, String>) -> BTreeMap<Module, BTreeSet<Module>> {
    let mut needs: BTreeMap<Module, BTreeSet<Module>> = BTreeMap::new();
    for (from, code) in sources {
        for mut to in paths(from, code) {
            while !to.is_empty() && !sources.contains_key(&to) {
                to.pop();
            }
            let n_common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
            if n_common < from.len() && n_common < to.len() {
                needs.entry(from[..=n_common].to_vec()).or_default().insert(to[..=n_common].to_vec());
            }
        }
    }
    needs
}

/// The modules that depend on themselves through others.
fn circles(needs: &BTreeMap<Module, BTreeSet<Module>>) -> Vec<String> {
    let leads_back = |start: &Module| {
        let (mut open, mut seen) = (vec![start], BTreeSet::new());
        while let Some(next) = open.pop() {
            for need in needs.get(next).into_iter().flatten() {
                if need == start {
                    return true;
                }
                if seen.insert(need) {
                    open.push(need);
                }
            }
        }
        false
    };
    needs.keys().filter(|module| leads_back(module)).map(|module| module.join("::")).collect()
}

#[test]
fn no_crate_has_a_circle_of_files() {
    for member in members() {
        let src = root().join(&member).join("src");
        let is_code = |module: &Module| !module.iter().any(|name| name == "tests" || name == "samples");
        let sources = files(&src, &["rs"]).into_iter().map(|path| {
            let inside = path.strip_prefix(&src).expect("the file was found there");
            (module(inside), code(&read(&path)))
        });
        let sources: BTreeMap<Module, String> = sources.filter(|(module, _)| is_code(module)).collect();
        assert_eq!(circles(&needs(&sources)), Vec::<String>::new(), "{member} has files that need each other");
    }
}

#[test]
fn a_circle_is_found() {
    let named = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Module>();
    let sources = BTreeMap::from([
        (named(&[]), "mod a; mod b; pub use a::A;".to_owned()),
        (named(&["a"]), "use crate::b::{c::C, D};".to_owned()),
        (named(&["b"]), "use super::e::E;".to_owned()),
        (named(&["b", "c"]), "use super::B; fn f(x: crate::a::A) {}".to_owned()),
        (named(&["e"]), "use self::Own;".to_owned()),
    ]);
    assert_eq!(circles(&needs(&sources)), ["a", "b"]);
}
