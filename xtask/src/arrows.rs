//! Which room may lean on which: the design's table, held against `cargo metadata`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

/// Every room of the library and the rooms it may name in its manifest. A room that is not here is a fault,
/// so a new room is a decision someone makes in this file.
const ALLOWED: &[(&str, &[&str])] = &[
    ("geometry", &[]),
    ("kernels", &[]),
    ("descriptor", &["kernels"]),
    ("solvers", &["geometry"]),
    ("robust", &["geometry", "kernels", "solvers"]),
    ("query", &["geometry", "descriptor"]),
    ("features", &["geometry", "descriptor"]),
    ("obfuscation", &["geometry", "descriptor", "features", "query"]),
    ("map", &["geometry", "descriptor", "kernels", "query"]),
    ("mapping", &["geometry", "descriptor", "features", "map", "query", "robust"]),
    ("localize", &["geometry", "descriptor", "query", "map", "robust"]),
    ("server", &["geometry", "query", "map", "localize", "robust"]),
    ("attacks", &["geometry", "obfuscation", "query", "map", "descriptor"]),
    ("synth", &["geometry"]),
    ("datasets", &["geometry", "features", "query", "robust"]),
    (
        "eval",
        &[
            "datasets",
            "features",
            "geometry",
            "localize",
            "map",
            "mapping",
            "obfuscation",
            "query",
            "robust",
            "synth",
        ],
    ),
    (
        "audit",
        &[
            "attacks",
            "datasets",
            "descriptor",
            "eval",
            "features",
            "geometry",
            "obfuscation",
            "query",
            "robust",
            "synth",
        ],
    ),
    ("report", &["attacks", "audit", "eval", "geometry", "query"]),
    (
        "demo",
        &[
            "audit",
            "datasets",
            "eval",
            "features",
            "geometry",
            "localize",
            "map",
            "mapping",
            "obfuscation",
            "query",
            "report",
            "synth",
        ],
    ),
];

/// The server's side must not even be able to name a keypoint of a query: not directly, not through others.
const SERVER_SIDE: &[&str] = &["localize", "map", "server"];
const DEVICE_SIDE: &[&str] = &["features", "obfuscation"];

/// Rooms that the others may not lean on: they sit at the end of the arrows.
const ENDS: &[&str] = &["cli"];

/// Checks all arrows; returns how many rooms there are.
pub(crate) fn check(root: &Path, faults: &mut Vec<String>) -> Result<usize, String> {
    let direct = direct_dependencies(root)?;
    let allowed: BTreeMap<&str, &[&str]> = ALLOWED.iter().copied().collect();
    for (room, dependencies) in &direct {
        if ENDS.contains(&room.as_str()) {
            continue;
        }
        let Some(list) = allowed.get(room.as_str()) else {
            faults.push(format!("room {room} is not in the table of arrows (xtask/src/arrows.rs)"));
            continue;
        };
        for dependency in dependencies.iter().filter(|d| !list.contains(&d.as_str())) {
            faults.push(format!("arrow {room} -> {dependency} is not in the design"));
        }
    }
    for room in SERVER_SIDE {
        let reached = reach(room, &direct);
        for forbidden in DEVICE_SIDE.iter().filter(|d| reached.contains(**d)) {
            faults.push(format!(
                "{room} reaches {forbidden}: the server side could name a keypoint of a query"
            ));
        }
    }
    Ok(direct.len())
}

/// `veiloc-*` dependencies of every `veiloc-*` package that ships, prefixes cut, test-only dependencies left out.
fn direct_dependencies(root: &Path) -> Result<BTreeMap<String, BTreeSet<String>>, String> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps"])
        .current_dir(root)
        .output()
        .map_err(|e| format!("cargo metadata: {e}"))?;
    if !output.status.success() {
        return Err(format!("cargo metadata: {}", String::from_utf8_lossy(&output.stderr)));
    }
    let metadata: serde_json::Value =
        serde_json::from_slice(&output.stdout).map_err(|e| format!("cargo metadata: {e}"))?;
    let room = |name: &serde_json::Value| name.as_str()?.strip_prefix("veiloc-").map(str::to_owned);
    let list = |value: &serde_json::Value| value.as_array().cloned().unwrap_or_default();
    let mut rooms = BTreeMap::new();
    for package in list(&metadata["packages"]) {
        let Some(name) = room(&package["name"]).filter(|name| name != "benches") else { continue };
        let dependencies = list(&package["dependencies"])
            .iter()
            .filter(|d| d["kind"].as_str() != Some("dev"))
            .filter_map(|d| room(&d["name"]))
            .collect();
        rooms.insert(name, dependencies);
    }
    if rooms.is_empty() {
        return Err("cargo metadata names no room at all".to_owned());
    }
    Ok(rooms)
}

fn reach(from: &str, direct: &BTreeMap<String, BTreeSet<String>>) -> BTreeSet<String> {
    let mut seen = BTreeSet::new();
    let mut open = vec![from.to_owned()];
    while let Some(room) = open.pop() {
        for next in direct.get(&room).into_iter().flatten() {
            if seen.insert(next.clone()) {
                open.push(next.clone());
            }
        }
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph(arrows: &[(&str, &[&str])]) -> BTreeMap<String, BTreeSet<String>> {
        arrows.iter().map(|(a, bs)| ((*a).to_owned(), bs.iter().map(|b| (*b).to_owned()).collect())).collect()
    }

    #[test]
    fn a_detour_is_found() {
        let g = graph(&[
            ("localize", &["map"]),
            ("map", &["helper"]),
            ("helper", &["features"]),
            ("features", &[]),
        ]);
        assert!(reach("localize", &g).contains("features"));
        assert!(!reach("features", &g).contains("localize"));
    }

    #[test]
    fn the_table_itself_keeps_the_server_blind() {
        let g = graph(ALLOWED);
        for room in SERVER_SIDE.iter().filter(|r| g.contains_key(**r)) {
            for device in DEVICE_SIDE {
                assert!(!reach(room, &g).contains(*device), "{room} reaches {device}");
            }
        }
    }
}
