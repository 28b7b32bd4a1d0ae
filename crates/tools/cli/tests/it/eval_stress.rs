//! `veiloc eval stress`: one scene under hard conditions.

use super::common;

use common::{QUERIES, scene};
use serde_json::Value;

const SCENE_ARGS: &str = "--posed posed --images images --map-list map.txt --query-list queries.txt \
                          --max-keypoints 512 --query-keypoints 512 --schemes points,dcl";

fn document(bytes: &[u8]) -> Value {
    serde_json::from_slice(bytes).expect("a document")
}

fn list<'a>(document: &'a Value, of: &str) -> &'a Vec<Value> {
    document[of].as_array().unwrap_or_else(|| panic!("no {of}"))
}

#[test]
fn every_stress_has_rows_and_none_is_first() {
    let scene = scene();
    let run = scene.run(&format!("eval stress {SCENE_ARGS} --optimum --json stress.json")).succeeded();
    assert!(
        run.stdout.contains("optimum ≤0.05/5 %") && run.stderr.contains("one image in 3, 4 images"),
        "{run}"
    );
    let result = document(&scene.read("stress.json"));
    let rows = list(&result, "rows");
    let order: Vec<&str> = rows.iter().filter_map(|r| r["stress"].as_str()).step_by(2).collect();
    let expected = [
        "none",
        "dark",
        "motion",
        "half-hidden",
        "side-hidden",
        "low-resolution",
        "sparse-map",
        "few-keypoints",
    ];
    assert_eq!(order, expected);
    assert_eq!((&result["sparse_map"]["stride"], &result["sparse_map"]["images"]), (&3.into(), &4.into()));
    let row = |stress: &str, scheme: &str| {
        let found = rows.iter().find(|r| r["stress"] == stress && r["scheme"] == scheme);
        found.unwrap_or_else(|| panic!("no row of {stress}, {scheme}"))
    };
    for row in rows {
        let count = |of: &str| row[of].as_u64().unwrap_or_else(|| panic!("no {of}: {row}"));
        assert_eq!(count("queries"), QUERIES as u64);
        assert_eq!(count("trusted") + count("doubtful") + count("not_found"), count("queries"), "{row}");
        assert!(count("search_failures") <= count("queries") - count("correct"), "{row}");
    }
    for scheme in ["points", "dcl"] {
        let none = row("none", scheme);
        assert_eq!((&none["recall"]["0.25/2"], &none["trusted_wrong"]), (&1.0.into(), &0.into()), "{none}");
        assert_eq!(none["floor"]["recall"]["0.25/2"], 1.0, "{none}");
    }
    // Each stress condition reduces the matches.
    let matches = |stress: &str| -> u64 {
        let own =
            list(&result, "queries").iter().filter(|q| q["stress"] == stress && q["scheme"] == "points");
        own.filter_map(|q| q["matches"].as_u64()).sum()
    };
    for stress in &expected[1..] {
        assert!(matches(stress) < matches("none"), "{stress}: {} of {}", matches(stress), matches("none"));
    }
    assert!(matches("few-keypoints") <= 256 * QUERIES as u64);
}

/// Without stress it equals `eval scene`: the same poses.
#[test]
fn unstressed_rows_equal_eval_scene() {
    let scene = scene();
    let none =
        scene.run(&format!("eval stress {SCENE_ARGS} --stress none --seed 3 --json -")).succeeded().json();
    assert_eq!(list(&none, "rows").len(), 2);
    assert!(none.get("sparse_map").is_none() && none["rows"][0].get("optimum").is_none());
    let of_scene = scene.run(&format!("eval scene {SCENE_ARGS} --seed 3 --json -")).succeeded().json();
    let errors = |document: &Value| -> Vec<(Value, Value, Value)> {
        let of = |q: &Value| (q["name"].clone(), q["translation_error"].clone(), q["state"].clone());
        list(document, "queries").iter().map(of).collect()
    };
    assert_eq!(errors(&none), errors(&of_scene));
}

/// The rows without gravity equal those of a scene without gravity, and each is followed by one with gravity.
#[test]
fn gravity_adds_a_row_to_each() {
    let scene = scene();
    let run = |more: &str| {
        let stress = format!("eval stress {SCENE_ARGS} --stress sparse-map --seed 3 {more} --json -");
        scene.run(&stress).succeeded().json()
    };
    let (plain, with_gravity) = (run(""), run("--gravity 0.5"));
    let with = |document: &Value, of: &str, is_told: bool| -> Vec<Value> {
        let rows = list(document, of).iter().filter(|row| row.get("gravity_sd_deg").is_some() == is_told);
        rows.cloned().collect()
    };
    for of in ["rows", "queries"] {
        assert_eq!(with(&with_gravity, of, false), *list(&plain, of), "{of}");
        assert_eq!(with(&with_gravity, of, true).len(), list(&plain, of).len(), "{of}");
    }
    let rows = list(&with_gravity, "rows");
    for pair in rows.chunks(2) {
        assert_eq!((&pair[0]["scheme"], &pair[0]["stress"]), (&pair[1]["scheme"], &pair[1]["stress"]));
        assert_eq!((pair[0].get("gravity_sd_deg"), &pair[1]["gravity_sd_deg"]), (None, &0.5.into()));
    }
    assert_ne!(
        with(&with_gravity, "rows", true)[0]["median_rotation_deg"],
        plain["rows"][0]["median_rotation_deg"]
    );

    let of_scene = scene.run(&format!("eval scene {SCENE_ARGS} --seed 3 --gravity 0.5 --json -")).succeeded();
    let gravity: Vec<Value> =
        list(&of_scene.json(), "schemes").iter().map(|s| s["gravity"].clone()).collect();
    assert_eq!(gravity, ["none", "0.5", "none", "0.5"]);
}

#[test]
fn equal_seeds_give_equal_tables_for_any_thread_count() {
    let scene = scene();
    let with = |threads: &str, seed: u32| {
        let arguments =
            format!("eval stress {SCENE_ARGS} --stress dark,motion,half-hidden --seed {seed} --json -");
        let output = scene.command(&arguments).env("RAYON_NUM_THREADS", threads).output().expect("runs");
        let mut result = document(&output.stdout);
        result["map"]["build_seconds"] = Value::Null;
        result
    };
    let one = with("1", 5);
    assert_eq!(one, with("3", 5));
    assert_ne!(one["queries"], with("3", 6)["queries"]);
}

#[test]
fn invalid_arguments_are_refused() {
    let scene = scene();
    scene.write("both.txt", "query-0.png\nmap-00.png\n");
    let given = "--posed posed --images images --map-list map.txt";
    let cases: &[(&str, i32, &[&str])] = &[
        (&format!("{given} --query-list queries.txt --stress light"), 2, &["light", "half-hidden"]),
        (&format!("{given} --query-list queries.txt --wrong-threshold 0.25"), 2, &["TRANSLATION/DEGREES"]),
        (&format!("{given} --query-list queries.txt --oracle-radius 0"), 2, &["above 0"]),
        (
            &format!("{given} --query-list both.txt --max-keypoints 256"),
            1,
            &["map-00.png", "must not be in the map"],
        ),
        (&format!("{given} --query-list queries.txt --gravity 17"), 1, &["gravity", "16"]),
        (&format!("{given} --query-list queries.txt --gravity=-1"), 2, &["above 0"]),
        (&format!("{given} --query-list no-such.txt"), 1, &["no-such.txt"]),
    ];
    for (arguments, code, expected_words) in cases {
        let run = scene.run(&format!("eval stress {arguments}"));
        assert_eq!(run.code, Some(*code), "{run}");
        assert!(
            run.stdout.is_empty() && expected_words.iter().all(|word| run.stderr.contains(word)),
            "{run}"
        );
    }
}
