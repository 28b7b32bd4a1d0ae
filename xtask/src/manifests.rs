//! What every manifest says, so that `cargo package --workspace` passes and the registry's page is of use.
//!
//! A new room copies this head; everything else is inherited:
//!
//! ```toml
//! [package]
//! name = "veiloc-NAME"
//! description = "One line: what the room is for"
//! keywords = ["visual-localization", "privacy", "…"]     # one to five
//! categories = ["computer-vision", "…"]                  # one to five, of crates.io's list
//! readme = "README.md"                                   # or `readme.workspace = true`
//! version.workspace = true
//! edition.workspace = true
//! rust-version.workspace = true
//! license.workspace = true
//! publish.workspace = true
//!
//! [lints]
//! workspace = true
//! ```
//!
//! and the workspace names it with its version: `veiloc-NAME = { path = "crates/NAME", version = "0.1.0" }`.

use std::collections::BTreeMap;

use serde_json::Value;

use crate::workspace::{Package, Workspace};

/// crates.io's bounds.
const MOST_KEYWORDS: usize = 5;
const LONGEST_KEYWORD: usize = 20;

/// Checks the manifests of all packages of the workspace.
pub(crate) fn check(workspace: &Workspace, faults: &mut Vec<String>) {
    let published: BTreeMap<&str, bool> =
        workspace.ours().map(|p| (p.text("name"), is_published(p))).collect();
    for package in workspace.ours() {
        let mut fault = |text: String| faults.push(format!("{}: {text}", package.text("name")));
        if package.room().is_some() != is_published(package) {
            fault("crates of `crates/` are published, all others say `publish = false`".to_owned());
        }
        for (field, why) in of_every_package(package) {
            fault(format!("`{field}` {why}"));
        }
        if is_published(package) {
            missing_for_the_registry(package).into_iter().for_each(&mut fault);
            wrong_dependencies(package, &published).into_iter().for_each(&mut fault);
        }
    }
}

fn is_published(package: &Package) -> bool {
    package.value["publish"].as_array().is_none_or(|registries| !registries.is_empty())
}

fn of_every_package(package: &Package) -> Vec<(&'static str, &'static str)> {
    let lacks = |field: &&str| package.text(field).is_empty();
    let fields = ["description", "license", "rust_version"];
    fields.into_iter().filter(lacks).map(|field| (field, "is missing")).collect()
}

fn missing_for_the_registry(package: &Package) -> Vec<String> {
    let mut faults = Vec::new();
    let list = |field: &str| -> Vec<String> {
        let values = package.value[field].as_array().into_iter().flatten();
        values.filter_map(Value::as_str).map(str::to_owned).collect()
    };
    for field in ["keywords", "categories"] {
        let count = list(field).len();
        if !(1..=MOST_KEYWORDS).contains(&count) {
            faults.push(format!("`{field}`: {count}, one to {MOST_KEYWORDS} are expected"));
        }
    }
    for keyword in list("keywords") {
        let is_plain = keyword.chars().all(|c| c.is_ascii_alphanumeric() || "-_+".contains(c));
        if !is_plain || keyword.len() > LONGEST_KEYWORD {
            faults.push(format!(
                "keyword `{keyword}`: crates.io takes up to {LONGEST_KEYWORD} letters, digits, -_+"
            ));
        }
    }
    if package.text("readme").is_empty() {
        faults.push("`readme` is missing".to_owned());
    }
    faults
}

/// A dependency on a sibling carries a version, so that it means something outside this repository, and its sibling is
/// published. Siblings that only tests need carry none: cargo then leaves them out of the package, so that circles
/// through tests (a room tested with a room that leans on it) do not stand in the way of publishing.
fn wrong_dependencies(package: &Package, published: &BTreeMap<&str, bool>) -> Vec<String> {
    let mut faults = Vec::new();
    for dependency in package.dependencies() {
        let name = dependency["name"].as_str().unwrap_or_default();
        let Some(is_published) = published.get(name) else { continue };
        let has_version = dependency["req"].as_str().is_some_and(|req| req != "*");
        let is_for_tests = dependency["kind"].as_str() == Some("dev");
        if is_for_tests && has_version {
            faults
                .push(format!("the dev-dependency {name} is a path without a version, `{{ path = \"…\" }}`"));
        }
        let is_in_registry = has_version && *is_published;
        if !(is_for_tests || is_in_registry) {
            faults.push(format!("{name} is a dependency without a version, or is not published"));
        }
    }
    faults
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn package(change: impl Fn(&mut Value)) -> Package {
        let mut value = json!({
            "name": "veiloc-a", "version": "0.1.0", "manifest_path": "/w/crates/a/Cargo.toml",
            "description": "A", "license": "MIT", "rust_version": "1.90", "readme": "README.md",
            "keywords": ["privacy"], "categories": ["computer-vision"], "publish": null,
            "dependencies": [
                { "name": "veiloc-b", "req": "^0.1.0", "kind": null },
                { "name": "veiloc-test", "req": "*", "kind": "dev" },
                { "name": "rand", "req": "^0.9", "kind": "dev" },
            ],
        });
        change(&mut value);
        Package { value, is_ours: true }
    }

    fn faults(change: impl Fn(&mut Value)) -> Vec<String> {
        let sibling = |name: &str, folder: &str, publish: Value| {
            let mut p = package(|_| ());
            p.value["name"] = json!(name);
            p.value["manifest_path"] = json!(format!("/w/{folder}/Cargo.toml"));
            p.value["publish"] = publish;
            p.value["dependencies"] = json!([]);
            p
        };
        let packages = vec![
            package(change),
            sibling("veiloc-b", "crates/b", Value::Null),
            sibling("veiloc-test", "test", json!([])),
        ];
        let mut faults = Vec::new();
        check(&Workspace { root: "/w".into(), packages }, &mut faults);
        faults
    }

    #[test]
    fn a_whole_manifest_passes() {
        assert_eq!(faults(|_| ()), [""; 0]);
    }

    #[test]
    fn what_is_missing_is_named() {
        for field in ["description", "license", "rust_version", "readme", "keywords", "categories"] {
            let found = faults(|p| p[field] = Value::Null);
            assert!(found.len() == 1 && found[0].contains(field), "{field}: {found:?}");
        }
        assert_eq!(faults(|p| p["keywords"] = json!(["a", "b", "c", "d", "e", "f"])).len(), 1);
        assert_eq!(faults(|p| p["keywords"] = json!(["two words"])).len(), 1);
        assert_eq!(faults(|p| p["publish"] = json!([])).len(), 1, "a crate of `crates/` is published");
    }

    #[test]
    fn versions_of_siblings_are_where_they_belong() {
        assert_eq!(faults(|p| p["dependencies"][0]["req"] = json!("*")).len(), 1, "no version");
        assert_eq!(faults(|p| p["dependencies"][0]["name"] = json!("veiloc-test")).len(), 1, "not published");
        assert_eq!(faults(|p| p["dependencies"][1]["req"] = json!("^0.1.0")).len(), 1, "a version in tests");
    }
}
