//! The dependencies of others, held against `deny.toml` and against our minimum Rust version.
//!
//! `deny.toml` is in cargo-deny's language, and `cargo deny check bans licenses sources` reads the same file. Here it is
//! read from one call of `cargo metadata`, in a second instead of the minutes that building cargo-deny takes
//! (`docs/decisions/0012`). A key that this reader does not know is a fault: the file never promises what is not checked.

use std::collections::BTreeSet;

use serde::Deserialize;

use crate::licence;
use crate::workspace::Workspace;

/// `deny.toml`, as far as it is understood here.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Policy {
    graph: Graph,
    licenses: Licenses,
    bans: Bans,
    sources: Sources,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Graph {
    all_features: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Licenses {
    allow: Vec<String>,
    unused_allowed_license: String,
    exceptions: Vec<Exception>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Exception {
    #[serde(rename = "crate")]
    name: String,
    allow: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Bans {
    multiple_versions: String,
    wildcards: String,
    allow_wildcard_paths: bool,
    deny: Vec<Ban>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Ban {
    #[serde(rename = "crate")]
    name: String,
    reason: String,
    #[serde(default)]
    wrappers: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Sources {
    unknown_registry: String,
    unknown_git: String,
    allow_registry: Vec<String>,
}

/// Checks all packages; returns how many there are of others.
pub(crate) fn check(workspace: &Workspace, faults: &mut Vec<String>) -> Result<usize, String> {
    let path = workspace.root.join("deny.toml");
    let text = std::fs::read_to_string(&path).map_err(|e| format!("deny.toml: {e}"))?;
    let policy: Policy = toml::from_str(&text).map_err(|e| format!("deny.toml: {e}"))?;
    judge(workspace, &policy, faults);
    Ok(workspace.packages.iter().filter(|p| !p.is_ours).count())
}

fn judge(workspace: &Workspace, policy: &Policy, faults: &mut Vec<String>) {
    for (what, is_as_checked) in [
        ("graph.all-features", policy.graph.all_features),
        ("licenses.unused-allowed-license", policy.licenses.unused_allowed_license == "deny"),
        ("bans.multiple-versions", policy.bans.multiple_versions == "allow"),
        ("bans.wildcards", policy.bans.wildcards == "deny" && policy.bans.allow_wildcard_paths),
        ("sources.unknown-registry", policy.sources.unknown_registry == "deny"),
        ("sources.unknown-git", policy.sources.unknown_git == "deny"),
    ] {
        if !is_as_checked {
            faults.push(format!("deny.toml: {what} is not what xtask/src/dependencies.rs checks"));
        }
    }
    licenses(workspace, &policy.licenses, faults);
    bans(workspace, &policy.bans, faults);
    sources(workspace, &policy.sources, faults);
    rust_versions(workspace, faults);
}

/// Licences of all packages, ours too; what is allowed and never met is a fault.
fn licenses(workspace: &Workspace, policy: &Licenses, faults: &mut Vec<String>) {
    let mut used = BTreeSet::new();
    let mut used_exceptions = BTreeSet::new();
    for package in &workspace.packages {
        let expression = package.text("license");
        let exception = policy.exceptions.iter().find(|e| e.name == package.text("name"));
        let own = exception.map_or(&[][..], |e| &e.allow);
        let is_allowed = |licence: &str| policy.allow.iter().chain(own).any(|a| a == licence);
        match licence::is_satisfied(expression, &is_allowed) {
            Err(why) => faults.push(format!("{}: licence `{expression}`: {why}", package.title())),
            Ok(false) => faults.push(format!("{}: licence `{expression}` is not allowed", package.title())),
            Ok(true) => {
                used.extend(licence::terms(expression));
                used_exceptions.extend(exception.map(|e| e.name.as_str()));
            }
        }
    }
    for unused in policy.allow.iter().filter(|l| !used.contains(*l)) {
        faults.push(format!("deny.toml: licence {unused} is allowed and never met"));
    }
    for unused in policy.exceptions.iter().filter(|e| !used_exceptions.contains(e.name.as_str())) {
        faults.push(format!("deny.toml: an exception for {}, which nobody depends on", unused.name));
    }
}

/// Crates that are not used, or by their wrappers alone; and no dependency without a version.
fn bans(workspace: &Workspace, policy: &Bans, faults: &mut Vec<String>) {
    for package in &workspace.packages {
        for dependency in package.dependencies() {
            let name = dependency["name"].as_str().unwrap_or_default();
            // A path within the repository needs none.
            if package.is_ours && dependency["req"].as_str() == Some("*") && dependency["path"].is_null() {
                faults.push(format!("{}: {name} = \"*\"", package.text("name")));
            }
        }
    }
    for ban in &policy.deny {
        for found in workspace.packages.iter().filter(|p| p.text("name") == ban.name) {
            let by: Vec<&str> = (workspace.packages.iter())
                .filter(|p| p.dependencies().any(|d| d["name"].as_str() == Some(&ban.name)))
                .map(|p| p.text("name"))
                .filter(|user| !ban.wrappers.iter().any(|w| w == user))
                .collect();
            if ban.wrappers.is_empty() || !by.is_empty() {
                let by = by.join(", ");
                faults.push(format!("{}: not to be used ({}), used by {by}", found.title(), ban.reason));
            }
        }
    }
}

/// Everything comes from the registry, or lies here.
fn sources(workspace: &Workspace, policy: &Sources, faults: &mut Vec<String>) {
    for package in &workspace.packages {
        let source = package.value["source"].as_str();
        let is_known = source.map_or(package.is_ours, |source| {
            policy.allow_registry.iter().any(|a| source.strip_prefix("registry+") == Some(a))
        });
        if !is_known {
            let source = source.unwrap_or("a folder outside the workspace");
            faults.push(format!("{}: comes from {source}", package.title()));
        }
    }
}

/// No dependency asks for a newer Rust than we do. One that says nothing is not judged.
fn rust_versions(workspace: &Workspace, faults: &mut Vec<String>) {
    let number = |version: &str| -> Vec<u32> { version.split('.').filter_map(|n| n.parse().ok()).collect() };
    let Some(ours) = workspace.ours().map(|p| p.text("rust_version")).find(|v| !v.is_empty()) else {
        faults.push("no package of ours names its minimum Rust version".to_owned());
        return;
    };
    for package in &workspace.packages {
        let theirs = package.text("rust_version");
        if number(theirs) > [number(ours), vec![0]].concat() {
            faults.push(format!("{}: needs Rust {theirs}, we promise {ours}", package.title()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    use crate::workspace::Package;

    const POLICY: &str = r#"
        [graph]
        all-features = true
        [licenses]
        allow = ["MIT", "Apache-2.0"]
        unused-allowed-license = "deny"
        exceptions = [{ crate = "odd", allow = ["Zlib"] }]
        [bans]
        multiple-versions = "allow"
        wildcards = "deny"
        allow-wildcard-paths = true
        deny = [
            { crate = "heavy", reason = "it is heavy" },
            { crate = "held", reason = "one user", wrappers = ["ours"] },
        ]
        [sources]
        unknown-registry = "deny"
        unknown-git = "deny"
        allow-registry = ["https://registry"]
    "#;

    fn package(name: &str, change: impl Fn(&mut Value)) -> Package {
        let mut value = json!({
            "name": name, "version": "1.0.0", "license": "MIT OR Apache-2.0", "rust_version": "1.90.0",
            "source": "registry+https://registry", "dependencies": [],
        });
        change(&mut value);
        Package { value, is_ours: false }
    }

    fn faults(policy: &str, more: Vec<Package>) -> Vec<String> {
        let uses = json!([{ "name": "odd", "req": "^1" }, { "name": "held", "req": "^1" }]);
        let mut ours = package("ours", |p| {
            p["source"] = Value::Null;
            p["rust_version"] = json!("1.90");
            p["dependencies"] = uses.clone();
        });
        ours.is_ours = true;
        let mut packages =
            vec![ours, package("odd", |p| p["license"] = json!("Zlib")), package("held", |_| ())];
        packages.extend(more);
        let mut faults = Vec::new();
        judge(
            &Workspace { root: "/".into(), packages },
            &toml::from_str(policy).expect("valid"),
            &mut faults,
        );
        faults
    }

    #[test]
    fn what_keeps_to_the_policy_passes() {
        assert_eq!(faults(POLICY, vec![package("fine", |_| ())]), [""; 0]);
    }

    #[test]
    fn each_breach_is_named() {
        let one = |change: &dyn Fn(&mut Value), words: &str| {
            let found = faults(POLICY, vec![package("bad", change)]);
            assert!(found.len() == 1 && found[0].contains(words), "{words}: {found:?}");
        };
        one(&|p| p["license"] = json!("GPL-3.0-only"), "GPL-3.0-only");
        one(&|p| p["license"] = json!("Zlib"), "Zlib"); // the exception is another crate's
        one(&|p| p["license"] = Value::Null, "licence");
        one(&|p| p["source"] = json!("registry+https://elsewhere"), "elsewhere");
        one(&|p| p["source"] = json!("git+https://registry"), "git+");
        one(&|p| p["source"] = Value::Null, "outside the workspace");
        one(&|p| p["rust_version"] = json!("1.91"), "1.91");
        one(&|p| p["rust_version"] = json!("1.90.1"), "1.90.1");
        one(&|p| p["name"] = json!("heavy"), "it is heavy");
        one(&|p| p["dependencies"] = json!([{ "name": "held", "req": "^1" }]), "used by bad");
    }

    #[test]
    fn the_policy_promises_no_more_than_is_checked() {
        let swap = |from: &str, to: &str| {
            assert!(POLICY.contains(from));
            POLICY.replace(from, to)
        };
        assert_eq!(faults(&swap("unknown-git = \"deny\"", "unknown-git = \"warn\""), vec![]).len(), 1);
        assert_eq!(
            faults(&swap("\"Apache-2.0\"]", "\"Apache-2.0\", \"ISC\"]"), vec![]).len(),
            1,
            "never met"
        );
        assert_eq!(faults(&swap("crate = \"odd\"", "crate = \"none\""), vec![]).len(), 2, "exception unused");
        let unknown = swap("[sources]", "[sources]\nrequired-git-spec = \"rev\"");
        assert!(toml::from_str::<Policy>(&unknown).is_err());
    }
}
