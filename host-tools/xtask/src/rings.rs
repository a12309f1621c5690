//! Test that no modules of a crate import each other in a ring.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use crate::run::root;

/// Modules of a crate, each with the modules that it imports.
type Imports = BTreeMap<String, BTreeSet<String>>;

/// Finds the folders `src` of all crates.
fn sources() -> Vec<PathBuf> {
    let below = |folder: &str| fs::read_dir(root().join(folder)).unwrap();
    let crates = below("boards").chain(below("host-tools")).map(|entry| entry.unwrap().path());
    let sources = crates.chain([root()]).map(|folder| folder.join("src"));
    sources
        .filter(|folder| folder.join("lib.rs").exists() || folder.join("main.rs").exists())
        .collect()
}

/// Reads the imports of a crate's top-level modules; the crate's root is no module.
fn imports(src: &Path) -> Imports {
    let mut found = Imports::new();
    for entry in fs::read_dir(src).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        if !["lib", "main", "bin", "tests"].contains(&name.as_str()) {
            found.entry(name).or_default().extend(paths(&path));
        }
    }
    let names: BTreeSet<String> = found.keys().cloned().collect();
    for (name, uses) in &mut found {
        uses.retain(|used| used != name && names.contains(used));
    }
    found
}

/// Lists the modules that a file or folder names with `crate::`, without comments and tests.
fn paths(path: &Path) -> BTreeSet<String> {
    if path.is_dir() {
        let inner = fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path());
        return inner
            .filter(|path| !path.ends_with("tests"))
            .flat_map(|path| paths(&path))
            .collect();
    }
    if path.extension().is_none_or(|extension| extension != "rs") || path.ends_with("tests.rs") {
        return BTreeSet::new();
    }
    let text = fs::read_to_string(path).unwrap();
    let code = text.split("\n#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    let lines = code.lines().map(|line| line.split("//").next().unwrap_or_default());
    let code: String = lines.flat_map(|line| [line, " "]).collect();
    code.split("crate::").skip(1).flat_map(first_names).collect()
}

/// Lists the first names of a path: one, or one for each item in its braces.
fn first_names(path: &str) -> Vec<String> {
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    let name = |text: &str| text.trim_start().chars().take_while(|c| is_name(*c)).collect();
    let Some(group) = path.strip_prefix('{') else { return vec![name(path)] };
    let (mut names, mut depth) = (vec![name(group)], 0);
    for (at, letter) in group.char_indices() {
        match letter {
            '{' => depth += 1,
            '}' if depth == 0 => break,
            '}' => depth -= 1,
            ',' if depth == 0 => names.push(name(&group[at + 1..])),
            _ => {}
        }
    }
    names
}

/// Removes modules without imports, again and again, until only rings and their users are left.
fn rings(mut imports: Imports) -> Imports {
    loop {
        let free: Vec<String> = imports
            .iter()
            .filter(|(_, uses)| uses.is_empty())
            .map(|(name, _)| name.clone())
            .collect();
        if free.is_empty() {
            return imports;
        }
        imports.retain(|name, _| !free.contains(name));
        imports.values_mut().for_each(|uses| uses.retain(|used| !free.contains(used)));
    }
}

#[test]
fn modules_import_each_other_one_way() {
    let sources = sources();
    assert!(sources.len() > 10, "{sources:?}");
    for src in sources {
        let left = rings(imports(&src));
        assert!(left.is_empty(), "{}: a ring among {left:#?}", src.display());
    }
}

#[test]
fn ring_among_imports_is_found() {
    assert_eq!(first_names("{a::{b, c}, d, e::f};"), ["a", "d", "e"]);
    let uses = |of: &[&str]| of.iter().map(|name| (*name).to_owned()).collect::<BTreeSet<_>>();
    let chain = [("a", uses(&["b"])), ("b", uses(&["c"])), ("c", uses(&[]))];
    let imports = |list: [(&str, BTreeSet<String>); 3]| -> Imports {
        list.into_iter().map(|(name, uses)| (name.to_owned(), uses)).collect()
    };
    assert!(rings(imports(chain.clone())).is_empty());
    let [a, b, _] = chain;
    assert_eq!(rings(imports([a, b, ("c", uses(&["a"]))])).len(), 3);
}
