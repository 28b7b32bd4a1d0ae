//! Which file of a crate names which other: read from its `use` declarations and its paths.
//!
//! What a module only passes on (`pub use place::Place;`) is no arrow, and who names the passed-on item leans on the file
//! that defines it, not on the one that passes it on; otherwise every `lib.rs` would be in a circle.
//! The reading is by words, not by a compiler: macros that make paths and names that shadow a module are not seen.

use std::collections::{BTreeMap, BTreeSet};

use crate::rust_text;

/// A module's path inside its crate; the root's is empty.
type ModulePath = Vec<String>;

/// From each file (relative to `src/`) to the files that it names.
pub(crate) type FileArrows = BTreeMap<String, BTreeSet<String>>;

/// One name that a `use` brings into a module.
struct Import {
    /// What it is called here; `*` for everything.
    name: String,
    path: Vec<String>,
    is_public: bool,
}

struct Module {
    file: String,
    imports: Vec<Import>,
    /// The code without its `use` declarations.
    words: Vec<String>,
}

/// Reads a crate: names of files relative to `src/`, and their text. Tests are left out.
pub(crate) fn of_crate(files: &[(String, String)]) -> FileArrows {
    let modules: BTreeMap<ModulePath, Module> = files
        .iter()
        .filter(|(file, _)| !rust_text::is_tests(file))
        .map(|(file, text)| {
            let words = words(&rust_text::code(rust_text::without_tests(text)));
            let (imports, words) = split_uses(&words);
            (module_of(file), Module { file: file.clone(), imports, words })
        })
        .collect();
    let crate_files = Files { modules: &modules };
    modules.iter().map(|(path, module)| (module.file.clone(), crate_files.named_by(path, module))).collect()
}

/// `a/b.rs` and `a/b/mod.rs` are `a::b`; `lib.rs` and `main.rs` are the root.
fn module_of(file: &str) -> ModulePath {
    let mut path: ModulePath = file.trim_end_matches(".rs").split('/').map(str::to_owned).collect();
    if path.last().is_some_and(|last| last == "mod")
        || matches!(path[..], [ref one] if one == "lib" || one == "main")
    {
        path.pop();
    }
    path
}

struct Files<'a> {
    modules: &'a BTreeMap<ModulePath, Module>,
}

impl Files<'_> {
    fn named_by(&self, at: &ModulePath, module: &Module) -> BTreeSet<String> {
        let mut named = BTreeSet::new();
        let mut aliases: BTreeMap<&str, Vec<String>> = BTreeMap::new();
        for import in &module.imports {
            let Some(path) = self.absolute(at, &import.path) else { continue };
            if self.modules.contains_key(&path) && import.name != "*" {
                // A module: what is used of it shows in the paths that begin with its name.
                aliases.insert(&import.name, path);
                continue;
            }
            let is_passed_on = import.is_public && !module.words.contains(&import.name);
            if !is_passed_on {
                named.extend(self.file_of(&path, 0));
            }
        }
        for path in paths(&module.words) {
            let whole = match aliases.get(path[0].as_str()) {
                Some(module) => [module, &path[1..]].concat(),
                None => match self.absolute(at, &path) {
                    Some(path) => path,
                    None => continue,
                },
            };
            named.extend(self.file_of(&whole, 0));
        }
        named.remove(&module.file);
        named
    }

    /// A path from the crate's root, or nothing where it leads out of the crate.
    fn absolute(&self, at: &ModulePath, path: &[String]) -> Option<Vec<String>> {
        let mut base = at.clone();
        let mut rest = path;
        match path.first()?.as_str() {
            "crate" => (base, rest) = (Vec::new(), &path[1..]),
            "self" => rest = &path[1..],
            "super" => {
                while rest.first().is_some_and(|word| word == "super") {
                    base.pop()?;
                    rest = &rest[1..];
                }
            }
            child => {
                let is_child = self.modules.contains_key(&[at.as_slice(), &[child.to_owned()]].concat());
                if !is_child {
                    return None;
                }
            }
        }
        Some([base, rest.to_vec()].concat())
    }

    /// The file that defines what a path from the root names.
    fn file_of(&self, path: &[String], depth: usize) -> Option<String> {
        let mut module = Vec::new();
        for (index, word) in path.iter().enumerate() {
            module.push(word.clone());
            if self.modules.contains_key(&module) {
                continue;
            }
            module.pop();
            let here = self.modules.get(&module)?;
            let passed_on = here.imports.iter().find(|import| import.name == *word);
            return match passed_on.and_then(|import| self.absolute(&module, &import.path)) {
                Some(origin) if depth < 8 => self.file_of(&[&origin, &path[index + 1..]].concat(), depth + 1),
                _ if passed_on.is_some() => None, // from another crate
                _ => Some(here.file.clone()),
            };
        }
        self.modules.get(&module).map(|m| m.file.clone())
    }
}

/// Names, `::`, and single signs.
fn words(code: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut name = String::new();
    for c in code.chars().chain([' ']) {
        if c.is_alphanumeric() || c == '_' {
            name.push(c);
            continue;
        }
        if !name.is_empty() {
            words.push(std::mem::take(&mut name));
        }
        match words.last_mut() {
            Some(last) if c == ':' && last == ":" => last.push(':'),
            _ if !c.is_whitespace() => words.push(c.to_string()),
            _ => {}
        }
    }
    words
}

/// Takes the `use` declarations out.
fn split_uses(words: &[String]) -> (Vec<Import>, Vec<String>) {
    let (mut imports, mut rest) = (Vec::new(), Vec::new());
    let mut at = 0;
    while at < words.len() {
        // `use<'a>` is a bound of a return type.
        if words[at] != "use" || words.get(at + 1).is_some_and(|w| w == "<") {
            rest.push(words[at].clone());
            at += 1;
            continue;
        }
        let is_public = at > 0 && (words[at - 1] == "pub" || words[at - 1] == ")");
        let end = words[at..].iter().position(|w| w == ";").map_or(words.len(), |n| at + n);
        tree(&words[at + 1..end], &[], is_public, &mut imports);
        at = end + 1;
    }
    (imports, rest)
}

/// One `use` tree: `a::{b, c as d, e::*}`.
fn tree(words: &[String], before: &[String], is_public: bool, imports: &mut Vec<Import>) {
    let mut path = before.to_vec();
    let mut name = None;
    let mut at = 0;
    while at < words.len() {
        match words[at].as_str() {
            "{" => {
                let inner = &words[at + 1..words.len() - 1];
                return parts(inner).into_iter().for_each(|part| tree(part, &path, is_public, imports));
            }
            "as" => {
                name = words.get(at + 1).cloned();
                at += 1;
            }
            "::" => {}
            "*" => name = Some("*".to_owned()),
            "self" if !before.is_empty() => {}
            word => path.push(word.to_owned()),
        }
        at += 1;
    }
    if let Some(name) = name.or_else(|| path.last().cloned()) {
        imports.push(Import { name, path, is_public });
    }
}

/// Parts between the commas that are in no inner braces.
fn parts(words: &[String]) -> Vec<&[String]> {
    let mut depth = 0;
    words
        .split(|word| {
            match word.as_str() {
                "{" => depth += 1,
                "}" => depth -= 1,
                _ => {}
            }
            depth == 0 && word == ","
        })
        .filter(|part| !part.is_empty())
        .collect()
}

/// All paths of at least two names.
fn paths(words: &[String]) -> Vec<Vec<String>> {
    let mut paths = Vec::new();
    let mut at = 0;
    while at < words.len() {
        let is_start = words[at].starts_with(|c: char| c.is_alphabetic() || c == '_');
        if !is_start || (at > 0 && words[at - 1] == "::") {
            at += 1;
            continue;
        }
        let mut path = vec![words[at].clone()];
        while at + 2 < words.len()
            && words[at + 1] == "::"
            && words[at + 2].starts_with(|c: char| c.is_alphabetic() || c == '_')
        {
            at += 2;
            path.push(words[at].clone());
        }
        if path.len() > 1 {
            paths.push(path);
        }
        at += 1;
    }
    paths
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrows(files: &[(&str, &str)]) -> Vec<String> {
        let files: Vec<(String, String)> =
            files.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect();
        let arrows = of_crate(&files);
        arrows.iter().flat_map(|(from, to)| to.iter().map(move |to| format!("{from} -> {to}"))).collect()
    }

    #[test]
    fn declarations_and_paths_are_arrows() {
        let found = arrows(&[
            ("lib.rs", "mod a; mod b; mod c; use a::Thing; fn f(x: Thing) {}"),
            ("a.rs", "use crate::{b::{B, Other as O}, c};\nfn f() { c::go(); super::c::go() }"),
            ("b/mod.rs", "mod inner; // crate::a\nfn f() { inner::g(\"crate::c\") }"),
            ("b/inner.rs", "use super::super::c::C;\n#[cfg(test)]\nmod tests { use crate::a::A; }"),
            ("c.rs", "use std::fs; use other::a::A;"),
            ("tests.rs", "use crate::a::A;"),
        ]);
        assert_eq!(
            found,
            [
                "a.rs -> b/mod.rs",
                "a.rs -> c.rs",
                "b/inner.rs -> c.rs",
                "b/mod.rs -> b/inner.rs",
                "lib.rs -> a.rs",
            ]
        );
    }

    #[test]
    fn what_is_passed_on_belongs_to_who_defined_it() {
        let found = arrows(&[
            ("lib.rs", "mod a; mod b; pub use a::Thing; pub(crate) use b::{go, stay}; fn f() { stay() }"),
            ("a.rs", "use crate::go; use crate::Error; use super::f;"),
            ("b.rs", "use crate::Thing;"),
        ]);
        assert_eq!(found, ["a.rs -> b.rs", "a.rs -> lib.rs", "b.rs -> a.rs", "lib.rs -> b.rs"]);
    }
}
