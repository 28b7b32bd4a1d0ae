//! Checks dependencies between the folders of `crates/`, so that no server crate can name the keypoints of a query.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// A folder of `crates/`, and the folders and crates on which it must not depend, directly or indirectly. Tests may.
const FORBIDDEN: [(&str, &[&str]); 5] = [
    ("core", &["device", "server", "tools", "research"]),
    ("device", &["server", "tools", "research"]),
    ("server", &["device", "tools", "research"]),
    // The operator's side draws no page and makes no map by a study; research uses everything but the program.
    ("tools", &["research", "cli"]),
    ("research", &["cli"]),
];

/// A crate of the workspace: its folder in `crates/`, and its dependencies outside of tests.
struct Crate {
    folder: String,
    dependencies: Vec<String>,
}

/// Checks all crates in `crates/`; returns how many there are.
pub(crate) fn check(root: &Path, faults: &mut Vec<String>) -> Result<usize, String> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--all-features", "--no-deps", "--offline"])
        .current_dir(root)
        .output()
        .map_err(|e| format!("cargo metadata: {e}"))?;
    if !output.status.success() {
        return Err(format!("cargo metadata: {}", String::from_utf8_lossy(&output.stderr)));
    }
    let metadata = serde_json::from_slice(&output.stdout).map_err(|e| format!("cargo metadata: {e}"))?;
    let crates = read(&metadata);
    if crates.len() < 2 {
        return Err("cargo metadata names no crates".to_owned());
    }
    check_dependencies(&crates, faults);
    Ok(crates.len())
}

fn read(metadata: &Value) -> BTreeMap<String, Crate> {
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let of_package = |package: &Value| {
        let manifest = text(&package["manifest_path"]);
        let (_, inside) = manifest.rsplit_once("/crates/")?;
        let folder = inside.split('/').next()?.to_owned();
        let is_real = |d: &Value| d["kind"].as_str() != Some("dev");
        let dependencies =
            list(&package["dependencies"]).iter().filter(|d| is_real(d)).map(|d| text(&d["name"])).collect();
        Some((text(&package["name"]), Crate { folder, dependencies }))
    };
    list(&metadata["packages"]).iter().filter_map(of_package).collect()
}

fn check_dependencies(crates: &BTreeMap<String, Crate>, faults: &mut Vec<String>) {
    for (name, from) in crates {
        let Some((_, forbidden)) = FORBIDDEN.iter().find(|(folder, _)| *folder == from.folder) else {
            continue;
        };
        let mut open = vec![(name.clone(), name.clone())];
        let mut seen = BTreeSet::new();
        while let Some((at, path)) = open.pop() {
            for next in crates.get(&at).into_iter().flat_map(|c| &c.dependencies) {
                let Some(reached) = crates.get(next).filter(|_| seen.insert(next.clone())) else { continue };
                let path = format!("{path} -> {next}");
                let is_forbidden = |f: &&str| *f == reached.folder || next == &format!("veiloc-{f}");
                if forbidden.iter().any(is_forbidden) {
                    faults.push(format!(
                        "{path}: crates/{} must not depend on crates/{}",
                        from.folder, reached.folder
                    ));
                }
                open.push((next.clone(), path));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// Folder and name of a crate, with names and kinds of its dependencies.
    type Package<'a> = (&'a str, &'a str, &'a [(&'a str, Option<&'a str>)]);

    fn faults(packages: &[Package<'_>]) -> Vec<String> {
        let package = |(folder, name, dependencies): &Package<'_>| {
            let dependencies: Vec<Value> = dependencies
                .iter()
                .map(|(n, kind)| json!({"name": format!("veiloc-{n}"), "kind": kind}))
                .collect();
            json!({
                "name": format!("veiloc-{name}"),
                "manifest_path": format!("/w/crates/{folder}/{name}/Cargo.toml"),
                "dependencies": dependencies,
            })
        };
        let packages: Vec<Value> = packages.iter().map(package).collect();
        let mut faults = Vec::new();
        check_dependencies(&read(&json!({ "packages": packages })), &mut faults);
        faults
    }

    #[test]
    fn server_never_depends_on_device_even_indirectly() {
        let features = ("device", "features", &[] as &[_]);
        let found = faults(&[
            ("server", "service", &[("map", None)]),
            ("server", "map", &[("features", None)]),
            features,
        ]);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(
            found.iter().any(|f| f.contains("veiloc-service -> veiloc-map -> veiloc-features")),
            "{found:?}"
        );
        assert_eq!(
            faults(&[("server", "map", &[("features", Some("dev"))]), features]),
            Vec::<String>::new()
        );
    }

    #[test]
    fn only_the_program_depends_on_research() {
        let attacks = ("research", "attacks", &[] as &[_]);
        assert_eq!(faults(&[("cli", "", &[("attacks", None)]), attacks]), Vec::<String>::new());
        for folder in ["core", "device", "server", "tools"] {
            assert_eq!(faults(&[(folder, "x", &[("attacks", Some("build"))]), attacks]).len(), 1);
        }
    }
}
