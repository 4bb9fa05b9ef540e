//! The layout of every crate's `src/`: no cycle of imports between files, nothing imports from a crate's root, at most
//! [`MAX_FLAT`] files lie flat, and every folder says what it holds.
//!
//! The sources are read as Rust tokens. An edge goes from a file to each file that a path in it names: `crate::…`,
//! `super::…`, `self::…` and paths that begin with a module that the file declares, in `use` lines or inline. What stands
//! below `#[cfg(test)]` does not count.

#![allow(clippy::unwrap_used, reason = "these are tests")]

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};

/// Rust files that may lie directly in a `src/`.
const MAX_FLAT: usize = 16;

/// Path of a module in its crate; empty for the root.
type Module = Vec<String>;

/// One source file.
struct File {
    path: PathBuf,
    /// Its tokens without the items below `#[cfg(test)]`.
    tokens: Vec<TokenTree>,
}

#[test]
fn no_cycle_between_files() {
    let found: Vec<String> = crates().iter().flat_map(|c| cycles(&imports(c), c)).collect();
    assert!(found.is_empty(), "{} cycles of imports:\n{}", found.len(), found.join("\n"));
}

#[test]
fn nothing_imports_from_a_crate_root() {
    let mut found = Vec::new();
    for files in crates() {
        for (from, _) in imports(&files).iter().filter(|(from, to)| !from.is_empty() && to.contains(&Module::new())) {
            found.push(files[*from].path.display().to_string());
        }
    }
    assert!(found.is_empty(), "files that import from their crate's lib.rs or main.rs:\n{}", found.join("\n"));
}

#[test]
fn few_files_lie_flat() {
    for source in sources() {
        let flat = entries(&source).into_iter().filter(|p| p.extension().is_some_and(|e| e == "rs")).count();
        assert!(flat <= MAX_FLAT, "{flat} files lie flat in {}", source.display());
    }
}

#[test]
fn every_folder_says_what_it_holds() {
    let mut found = Vec::new();
    for files in crates() {
        let parents: BTreeSet<&[String]> = files.keys().filter_map(|m| m.split_last()).map(|(_, p)| p).collect();
        found.extend(
            parents
                .into_iter()
                .filter_map(|p| files.get(p))
                .filter(|f| !has_inner_doc(&f.tokens))
                .map(|f| f.path.display().to_string()),
        );
    }
    assert!(found.is_empty(), "folders without a `//!` comment:\n{}", found.join("\n"));
}

/// `fuzz` stands outside the workspace and repeats what the executable depends on.
#[test]
fn fuzzing_has_the_dependencies_of_the_executable() {
    let read = |path: &str| -> toml::Table {
        std::fs::read_to_string(workspace().join(path).join("Cargo.toml")).unwrap().parse().unwrap()
    };
    let (root, fuzz) = (read("."), read("fuzz"));
    let mut found = Vec::new();
    for (name, dependency) in read("capture")["dependencies"].as_table().unwrap() {
        let asked = &root["workspace"]["dependencies"][name];
        let is_ours = asked.get("path").is_some();
        match fuzz["dependencies"].get(name) {
            _ if dependency.get("optional").is_some() => {}
            None => found.push(format!("{name} is missing")),
            Some(there) if !is_ours && there != asked => found.push(format!("{name} is {there}, not {asked}")),
            Some(_) => {}
        }
    }
    assert!(found.is_empty(), "fuzz/Cargo.toml:\n{}", found.join("\n"));
}

/// The workspace's folder.
fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

/// The `src/` folders of its crates.
fn sources() -> Vec<PathBuf> {
    entries(workspace()).into_iter().filter(|p| p.join("Cargo.toml").exists()).map(|p| p.join("src")).collect()
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut all: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    all.sort();
    all
}

/// The files of each crate by their module, without files that only tests have.
fn crates() -> Vec<BTreeMap<Module, File>> {
    let crates: Vec<_> = sources()
        .iter()
        .map(|source| {
            let mut files = BTreeMap::new();
            let root = ["main.rs", "lib.rs"].map(|name| source.join(name)).into_iter().find(|p| p.exists()).unwrap();
            add_file(Module::new(), &root, source, &mut files);
            files
        })
        .collect();
    assert!(crates.len() >= 6 && crates.iter().all(|c| c.len() > 1), "the sources were not found");
    crates
}

/// Adds a file and those of the modules that it declares.
fn add_file(module: Module, path: &Path, source: &Path, files: &mut BTreeMap<Module, File>) {
    let text = std::fs::read_to_string(path).unwrap();
    let tokens: TokenStream = text.parse().unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let tokens = without_tests(tokens);
    for child in declared(&tokens) {
        let mut name = module.clone();
        name.push(child);
        let place = name.iter().fold(source.to_path_buf(), |folder, part| folder.join(part));
        let flat = place.with_extension("rs");
        let file = if flat.exists() { flat } else { place.join("mod.rs") };
        add_file(name, &file, source, files);
    }
    files.insert(module, File { path: path.strip_prefix(workspace()).unwrap().into(), tokens });
}

/// The tokens without each item that follows `#[cfg(test)]`.
fn without_tests(tokens: TokenStream) -> Vec<TokenTree> {
    let all: Vec<TokenTree> = tokens.into_iter().collect();
    let mut kept = Vec::new();
    let mut i = 0;
    while i < all.len() {
        let is_test = is_punct(&all[i], '#')
            && matches!(all.get(i + 1), Some(TokenTree::Group(g)) if g.to_string().replace(' ', "") == "[cfg(test)]");
        if !is_test {
            kept.push(all[i].clone());
            i += 1;
            continue;
        }
        let end =
            |t: &TokenTree| is_punct(t, ';') || matches!(t, TokenTree::Group(g) if g.delimiter() == Delimiter::Brace);
        i = all[i..].iter().position(end).map_or(all.len(), |n| i + n + 1);
    }
    kept
}

/// Names of the modules that `mod name;` declares.
fn declared(tokens: &[TokenTree]) -> Vec<String> {
    let triples = tokens.windows(3).filter(|w| is_ident(&w[0], "mod") && is_punct(&w[2], ';'));
    triples.map(|w| w[1].to_string()).collect()
}

/// True if the file begins with `//!`.
fn has_inner_doc(tokens: &[TokenTree]) -> bool {
    matches!(tokens, [a, b, TokenTree::Group(g), ..]
        if is_punct(a, '#') && is_punct(b, '!') && g.stream().to_string().starts_with("doc"))
}

fn is_punct(token: &TokenTree, c: char) -> bool {
    matches!(token, TokenTree::Punct(p) if p.as_char() == c)
}

fn is_ident(token: &TokenTree, name: &str) -> bool {
    matches!(token, TokenTree::Ident(i) if i == name)
}

/// The modules whose files each file's paths name.
fn imports(files: &BTreeMap<Module, File>) -> BTreeMap<&Module, BTreeSet<Module>> {
    let mut all = BTreeMap::new();
    for (module, file) in files {
        let mut paths = Vec::new();
        collect_paths(&file.tokens, module, &declared(&file.tokens), &mut paths);
        let mut named: BTreeSet<Module> = paths.into_iter().map(|path| file_of(path, files)).collect();
        named.remove(module);
        all.insert(module, named);
    }
    all
}

/// The longest beginning of a path that is a module with a file.
fn file_of(mut path: Module, files: &BTreeMap<Module, File>) -> Module {
    while !files.contains_key(&path) {
        path.pop();
    }
    path
}

/// Every path in the tokens that stays in the crate, from its root.
fn collect_paths(tokens: &[TokenTree], module: &Module, children: &[String], paths: &mut Vec<Module>) {
    let mut i = 0;
    while i < tokens.len() {
        if let TokenTree::Group(group) = &tokens[i] {
            collect_paths(&without_tests(group.stream()), module, children, paths);
        }
        let is_first = i == 0 || !is_punct(&tokens[i - 1], ':') || i == 1 || !is_punct(&tokens[i - 2], ':');
        if let (TokenTree::Ident(first), true) = (&tokens[i], is_first) {
            let start = match first.to_string().as_str() {
                "crate" => Some(Module::new()),
                "self" => Some(module.clone()),
                "super" => Some(module[..module.len().saturating_sub(1)].to_vec()),
                name if children.iter().any(|c| c == name) => Some([module.as_slice(), &[name.to_owned()]].concat()),
                _ => None,
            };
            if let Some(start) = start.filter(|_| is_path_separator(tokens, i + 1)) {
                i = follow(tokens, i + 1, start, paths);
                continue;
            }
        }
        i += 1;
    }
}

fn is_path_separator(tokens: &[TokenTree], i: usize) -> bool {
    tokens.len() > i + 2 && is_punct(&tokens[i], ':') && is_punct(&tokens[i + 1], ':')
}

/// Reads the rest of a path from the `::` at `i`; returns where it ends.
fn follow(tokens: &[TokenTree], mut i: usize, mut path: Module, paths: &mut Vec<Module>) -> usize {
    while is_path_separator(tokens, i) {
        match &tokens[i + 2] {
            TokenTree::Ident(name) if name == "super" => drop(path.pop()),
            TokenTree::Ident(name) => path.push(name.to_string()),
            // `{a::b, c, self}`: each branch goes on from here.
            TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => {
                let branches: Vec<TokenTree> = group.stream().into_iter().collect();
                for branch in branches.split(|t| is_punct(t, ',')).filter(|b| !b.is_empty()) {
                    let mut longer = path.clone();
                    match branch[0].to_string().as_str() {
                        "self" | "*" => {}
                        name => longer.push(name.to_owned()),
                    }
                    follow(branch, 1, longer, paths);
                }
                return i + 3;
            }
            _ => break,
        }
        i += 3;
    }
    paths.push(path);
    i
}

/// One shortest cycle through each file that is its cycle's first, written `a.rs → b.rs → a.rs`.
fn cycles(imports: &BTreeMap<&Module, BTreeSet<Module>>, files: &BTreeMap<Module, File>) -> Vec<String> {
    let mut found = Vec::new();
    for start in imports.keys().filter(|m| !m.is_empty()) {
        let mut came_from: BTreeMap<&Module, &Module> = BTreeMap::new();
        let mut queue = VecDeque::from([*start]);
        while let Some(at) = queue.pop_front() {
            for next in imports[at].iter().filter(|m| !m.is_empty() && *m >= start) {
                if !came_from.contains_key(next) {
                    came_from.insert(next, at);
                    queue.push_back(next);
                }
            }
        }
        let mut cycle = vec![*start];
        while let Some(before) = came_from.get(cycle[cycle.len() - 1]) {
            cycle.push(before);
            if before == start {
                break;
            }
        }
        if cycle.len() > 1 {
            let names: Vec<_> = cycle.iter().rev().map(|m| files[*m].path.display().to_string()).collect();
            found.push(names.join(" → "));
        }
    }
    found
}
