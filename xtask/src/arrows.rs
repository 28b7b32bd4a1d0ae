//! Which room may lean on which: the design's table, held against `cargo metadata`.

use std::collections::{BTreeMap, BTreeSet};

use crate::workspace::Workspace;

/// Every room of the library and the rooms that it names in its manifest: no more and no fewer. A room that is not here
/// is a fault, and so is an arrow that nobody uses, so the table is what is, and a new arrow is a decision made here.
const ARROWS: &[(&str, &[&str])] = &[
    ("geometry", &[]),
    ("kernels", &[]),
    ("descriptor", &["kernels"]),
    ("solvers", &["geometry"]),
    ("likelihood", &["geometry", "descriptor", "kernels"]),
    ("robust", &["geometry", "kernels", "likelihood", "solvers"]),
    ("query", &["geometry", "descriptor"]),
    ("features", &["geometry", "descriptor", "kernels"]),
    ("obfuscation", &["geometry", "descriptor", "features", "query"]),
    ("networks", &["descriptor", "features", "geometry"]),
    ("hloc", &["descriptor", "features", "geometry", "replacing"]),
    ("detector", &["features", "networks"]),
    ("judge", &["features", "networks"]),
    ("client", &["features", "geometry", "obfuscation", "query"]),
    ("map", &["geometry", "descriptor", "kernels", "query", "replacing"]),
    ("mapping", &["geometry", "descriptor", "features", "map", "query"]),
    ("keeping", &["descriptor", "features", "mapping", "replacing"]),
    ("localize", &["geometry", "descriptor", "query", "map", "robust"]),
    ("store", &["access", "regions", "replacing"]),
    (
        "selftest",
        &["descriptor", "features", "geometry", "localize", "map", "mapping", "obfuscation", "query"],
    ),
    ("replacing", &[]),
    ("regions", &["access", "descriptor", "geometry", "kernels", "map", "query", "replacing"]),
    ("access", &["replacing"]),
    ("admission", &["access"]),
    ("observe", &[]),
    ("page", &["map"]),
    ("bus", &[]),
    ("transport", &["access", "admission", "observe"]),
    (
        "server",
        &[
            "access",
            "admission",
            "transport",
            "geometry",
            "query",
            "map",
            "localize",
            "observe",
            "page",
            "robust",
        ],
    ),
    (
        "cluster",
        &[
            "bus",
            "descriptor",
            "geometry",
            "localize",
            "map",
            "observe",
            "query",
            "regions",
            "robust",
            "server",
            "store",
        ],
    ),
    ("attacks", &["descriptor", "geometry", "query"]),
    ("training", &["geometry"]),
    ("outsider", &["attacks", "geometry", "obfuscation", "query", "training"]),
    ("sightings", &["attacks", "geometry"]),
    ("synth", &["geometry"]),
    ("datasets", &["geometry", "descriptor", "features", "query", "robust"]),
    ("places", &["geometry", "map", "replacing"]),
    ("results", &["geometry", "query", "robust"]),
    (
        "poses",
        &[
            "datasets",
            "features",
            "geometry",
            "localize",
            "obfuscation",
            "query",
            "results",
            "robust",
            "synth",
        ],
    ),
    ("retrieval", &["descriptor", "features", "map", "results"]),
    (
        "eval",
        &[
            "datasets",
            "descriptor",
            "features",
            "geometry",
            "keeping",
            "localize",
            "map",
            "mapping",
            "obfuscation",
            "poses",
            "query",
            "regions",
            "replacing",
            "results",
            "robust",
            "selftest",
            "synth",
        ],
    ),
    (
        "audit",
        &[
            "attacks",
            "datasets",
            "features",
            "geometry",
            "obfuscation",
            "outsider",
            "poses",
            "query",
            "results",
            "robust",
            "sightings",
        ],
    ),
    (
        "tradeoff",
        &[
            "attacks",
            "audit",
            "datasets",
            "descriptor",
            "eval",
            "features",
            "geometry",
            "localize",
            "map",
            "mapping",
            "obfuscation",
            "poses",
            "query",
            "results",
            "robust",
            "sightings",
            "synth",
        ],
    ),
    (
        "veiloc",
        &[
            "audit",
            "client",
            "datasets",
            "features",
            "geometry",
            "localize",
            "map",
            "mapping",
            "obfuscation",
            "query",
            "selftest",
        ],
    ),
    (
        "inversion",
        &[
            "attacks",
            "audit",
            "datasets",
            "detector",
            "features",
            "geometry",
            "judge",
            "obfuscation",
            "query",
            "results",
            "training",
        ],
    ),
    (
        "report",
        &[
            "attacks", "audit", "eval", "geometry", "localize", "map", "poses", "query", "results", "robust",
            "tradeoff",
        ],
    ),
    (
        "demo",
        &[
            "audit",
            "datasets",
            "eval",
            "features",
            "geometry",
            "map",
            "mapping",
            "obfuscation",
            "query",
            "report",
            "results",
            "synth",
        ],
    ),
    ("terminal", &["features", "geometry"]),
    (
        "arguments",
        &[
            "features",
            "geometry",
            "hloc",
            "localize",
            "mapping",
            "networks",
            "obfuscation",
            "query",
            "results",
            "robust",
            "terminal",
        ],
    ),
    (
        "measure",
        &[
            "arguments",
            "audit",
            "datasets",
            "eval",
            "features",
            "geometry",
            "inversion",
            "map",
            "mapping",
            "obfuscation",
            "places",
            "poses",
            "query",
            "regions",
            "report",
            "results",
            "retrieval",
            "robust",
            "synth",
            "terminal",
            "tradeoff",
        ],
    ),
    ("operate", &["access", "arguments", "bus", "cluster", "map", "observe", "page", "server", "terminal"]),
    (
        "cli",
        &[
            "access",
            "arguments",
            "audit",
            "client",
            "demo",
            "detector",
            "features",
            "geometry",
            "hloc",
            "keeping",
            "localize",
            "map",
            "mapping",
            "measure",
            "networks",
            "obfuscation",
            "operate",
            "query",
            "regions",
            "report",
            "results",
            "robust",
            "selftest",
            "server",
            "store",
            "terminal",
        ],
    ),
];

/// The server's side must not even be able to name a keypoint of a query: not directly, not through others.
const SERVER_SIDE: &[&str] = &["cluster", "localize", "map", "server"];
const DEVICE_SIDE: &[&str] = &["features", "obfuscation", "client"];

/// Whoever builds an app gets the device's road and nothing of a server's.
const DEVICE_ROAD: &str = "client";

/// Rooms that no other room may lean on: they sit at the end of the arrows.
const ENDS: &[&str] = &["cli"];

/// Who leans on whom.
pub(crate) type Arrows = BTreeMap<String, BTreeSet<String>>;

/// Checks all arrows; returns how many rooms there are.
pub(crate) fn check(workspace: &Workspace, faults: &mut Vec<String>) -> usize {
    let direct = direct_dependencies(workspace);
    compare(&direct, &table(ARROWS), faults);
    direct.len()
}

fn compare(direct: &Arrows, table: &Arrows, faults: &mut Vec<String>) {
    let none = BTreeSet::new();
    for (room, dependencies) in direct {
        let Some(allowed) = table.get(room) else {
            faults.push(format!("room {room} is not in the table of arrows (xtask/src/arrows.rs)"));
            continue;
        };
        for dependency in dependencies.difference(allowed) {
            faults.push(format!("arrow {room} -> {dependency} is not in the design"));
        }
        for dependency in dependencies.iter().filter(|d| ENDS.contains(&d.as_str())) {
            faults.push(format!("arrow {room} -> {dependency}: nothing may lean on {dependency}"));
        }
    }
    for (room, allowed) in table {
        if !direct.contains_key(room) {
            faults.push(format!("the table of arrows names room {room}, which does not exist"));
            continue;
        }
        for unused in allowed.difference(direct.get(room).unwrap_or(&none)) {
            faults.push(format!("arrow {room} -> {unused} is allowed, and nobody uses it"));
        }
    }
    for room in SERVER_SIDE {
        let reached = reach(room, direct);
        for forbidden in DEVICE_SIDE.iter().filter(|d| reached.contains(**d)) {
            faults.push(format!(
                "{room} reaches {forbidden}: the server side could name a keypoint of a query"
            ));
        }
    }
    let reached = reach(DEVICE_ROAD, direct);
    for forbidden in SERVER_SIDE.iter().filter(|d| reached.contains(**d)) {
        faults.push(format!(
            "{DEVICE_ROAD} reaches {forbidden}: a device would be built with a server's parts"
        ));
    }
}

fn table(rows: &[(&str, &[&str])]) -> Arrows {
    rows.iter().map(|(a, bs)| ((*a).to_owned(), bs.iter().map(|b| (*b).to_owned()).collect())).collect()
}

/// The rooms that every room names in its manifest; those of its tests are left out.
pub(crate) fn direct_dependencies(workspace: &Workspace) -> Arrows {
    let rooms: BTreeMap<&str, &str> =
        workspace.ours().filter_map(|p| Some((p.text("name"), p.room()?))).collect();
    let of = |package: &crate::workspace::Package| {
        (package.dependencies())
            .filter(|d| d["kind"].as_str() != Some("dev"))
            .filter_map(|d| rooms.get(d["name"].as_str()?).map(|room| (*room).to_owned()))
            .collect()
    };
    workspace.ours().filter_map(|p| Some((p.room()?.to_owned(), of(p)))).collect()
}

fn reach(from: &str, direct: &Arrows) -> BTreeSet<String> {
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

    fn faults(direct: &[(&str, &[&str])], allowed: &[(&str, &[&str])]) -> Vec<String> {
        let mut faults = Vec::new();
        compare(&table(direct), &table(allowed), &mut faults);
        faults
    }

    #[test]
    fn the_table_must_be_what_is() {
        let rooms: &[(&str, &[&str])] = &[("a", &["b"]), ("b", &[])];
        assert!(faults(rooms, rooms).is_empty());
        let new = faults(&[("a", &["b"]), ("b", &["a"])], rooms);
        assert_eq!(new, ["arrow b -> a is not in the design"]);
        let unused = faults(&[("a", &[]), ("b", &[])], rooms);
        assert_eq!(unused, ["arrow a -> b is allowed, and nobody uses it"]);
        let unlisted = faults(&[("a", &["b"]), ("b", &[]), ("c", &[])], rooms);
        assert_eq!(unlisted, ["room c is not in the table of arrows (xtask/src/arrows.rs)"]);
        let gone = faults(&[("b", &[])], rooms);
        assert_eq!(gone, ["the table of arrows names room a, which does not exist"]);
    }

    #[test]
    fn nothing_leans_on_an_end() {
        let rooms: &[(&str, &[&str])] = &[("a", &["cli"]), ("cli", &[])];
        assert_eq!(faults(rooms, rooms), ["arrow a -> cli: nothing may lean on cli"]);
    }

    #[test]
    fn a_detour_to_the_device_is_found() {
        let rooms: &[(&str, &[&str])] =
            &[("localize", &["map"]), ("map", &["helper"]), ("helper", &["features"]), ("features", &[])];
        let found = faults(rooms, rooms);
        assert!(found.iter().any(|f| f.starts_with("localize reaches features")), "{found:?}");
        assert_eq!(found.len(), 2, "map does so too: {found:?}");
    }

    #[test]
    fn the_table_itself_keeps_the_device_free_of_the_server() {
        let reached = reach(DEVICE_ROAD, &table(ARROWS));
        assert!(reached.contains("query") && SERVER_SIDE.iter().all(|room| !reached.contains(*room)));
    }

    #[test]
    fn the_table_itself_keeps_the_server_blind() {
        let table = table(ARROWS);
        for room in SERVER_SIDE {
            assert!(table.contains_key(*room), "{room} is not in the table");
            for device in DEVICE_SIDE {
                assert!(!reach(room, &table).contains(*device), "{room} reaches {device}");
            }
        }
    }
}
