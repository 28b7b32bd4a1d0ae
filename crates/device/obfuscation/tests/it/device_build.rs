//! What a program for devices is built of never has `ground-truth`: the doors that keep the answers are not in it.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use serde_json::Value;

/// Rooms of the device's road, as far as there are such. Whatever they reach must do without.
const DEVICE: [&str; 4] = ["veiloc-features", "veiloc-obfuscation", "veiloc-client", "veiloc-web"];
const FEATURE: &str = "ground-truth";

/// Dependencies of a package, but for tests: name and features asked for.
fn dependencies(package: &Value) -> Vec<(String, Vec<String>)> {
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    list(&package["dependencies"])
        .iter()
        .filter(|d| d["kind"].as_str() != Some("dev"))
        .map(|d| (text(&d["name"]), list(&d["features"]).iter().map(text).collect()))
        .collect()
}

/// Who, among everything reached from `from`, asks obfuscation for its answers.
fn askers(from: &str, packages: &BTreeMap<String, Value>) -> Vec<String> {
    let (mut open, mut seen, mut found) = (vec![from.to_owned()], BTreeSet::new(), Vec::new());
    while let Some(name) = open.pop() {
        let Some(package) = packages.get(&name).filter(|_| seen.insert(name.clone())) else { continue };
        for (dependency, features) in dependencies(package) {
            if dependency == "veiloc-obfuscation" && features.iter().any(|f| f == FEATURE) {
                found.push(name.clone());
            }
            open.push(dependency);
        }
    }
    found
}

#[test]
fn the_devices_road_has_no_answers() {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let packages: BTreeMap<String, Value> = metadata["packages"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|p| (p["name"].as_str().expect("a name").to_owned(), p.clone()))
        .collect();
    for room in DEVICE.iter().filter(|room| packages.contains_key(**room)) {
        assert_eq!(askers(room, &packages), Vec::<String>::new(), "{room} would be built with the answers");
    }
    let defaults = &packages["veiloc-obfuscation"]["features"]["default"];
    assert!(defaults.as_array().is_none_or(Vec::is_empty), "no feature is on by default: {defaults}");
    // The search sees who does ask: the command line, which evaluates too.
    assert!(!askers("veiloc-cli", &packages).is_empty(), "the search does not find what is there");
}
