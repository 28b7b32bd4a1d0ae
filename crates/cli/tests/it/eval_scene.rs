//! `veiloc eval scene`: progressive queries, covariances, and problems for `eval pose`.

use super::common;

use common::scene;

const SCENE: &str = "eval scene --posed posed --images images --map-list map.txt --query-list queries.txt \
                     --max-keypoints 1024 --query-keypoints 1024 --schemes points,dcl";

#[test]
fn progressive_queries_send_fewer_rows_for_the_same_pose() {
    let scene = scene();
    let rows = |more: &str| {
        let run = scene.run(&format!("{SCENE} {more} --json steps.json")).succeeded();
        assert!(run.stdout.contains("mean rows") && run.stdout.contains("mean exposed"), "{run}");
        let document: serde_json::Value =
            serde_json::from_slice(&scene.read("steps.json")).expect("a document");
        for query in document["queries"].as_array().expect("an array") {
            assert_eq!(query["ms"]["steps"].is_number(), more.contains("--progressive"), "{query}");
        }
        document["schemes"].as_array().expect("an array").clone()
    };
    let whole = rows("");
    let steps = rows("--progressive");
    let exact = rows("--progressive --accuracy 1e-9");
    for ((whole, steps), exact) in whole.iter().zip(&steps).zip(&exact) {
        let of = |row: &serde_json::Value, name: &str| row[name].as_f64().expect("a number");
        assert_eq!(of(whole, "mean_rows"), 1024.0);
        assert_eq!(of(whole, "mean_bytes"), of(whole, "sealed_bytes"));
        assert!(
            of(steps, "mean_rows") < 600.0 && of(steps, "mean_bytes") < of(whole, "mean_bytes"),
            "{steps}"
        );
        assert!(of(steps, "mean_exposed") < of(whole, "mean_exposed"), "{steps}");
        assert_eq!(steps["localized"], whole["localized"]);
        // This accuracy is unreachable: every byte of every step counts, and the pose is that of all rows.
        assert_eq!(of(exact, "mean_rows"), 1024.0);
        assert!(of(exact, "mean_bytes") > 1.5 * of(whole, "mean_bytes"), "{exact}");
        assert_eq!(exact["median_translation"], whole["median_translation"]);
    }
}

/// Rendered poses are exact, so that covariances can be compared with the errors.
#[test]
fn covariances_are_compared_with_errors() {
    let scene = scene();
    let run = scene.run(&format!("{SCENE} --json covered.json")).succeeded();
    assert!(run.stdout.contains("centre 90 %") && run.stdout.contains("error / ±"), "{run}");
    let document: serde_json::Value =
        serde_json::from_slice(&scene.read("covered.json")).expect("a document");
    for row in document["schemes"].as_array().expect("an array") {
        let count = |state: &str| row[state].as_u64().expect("a count");
        assert_eq!(count("trusted") + count("doubtful") + count("not_found"), count("queries"), "{row}");
        for regions in [&row["coverage"], &row["coverage_pose"]] {
            let share = |percent: &str| regions[percent].as_f64().expect("a share");
            assert!(share("50") <= share("90") && share("90") <= share("99") && share("99") <= 1.0, "{row}");
        }
        // Three queries only show that errors and standard deviations have the same magnitude.
        let ratio = row["center_error_over_sd"].as_f64().expect("a ratio");
        assert!((0.05..10.0).contains(&ratio), "{row}");
    }
    for query in document["queries"].as_array().expect("an array") {
        assert!(["trusted", "doubtful"].contains(&query["state"].as_str().expect("a state")), "{query}");
        let sd = query["position_sd"].as_f64().expect("a deviation");
        let ratio = query["center_error_over_sd"].as_f64().expect("a ratio");
        let error = query["translation_error"].as_f64().expect("an error");
        assert!(sd > 0.0 && (ratio * sd - error).abs() < 1e-9 * (1.0 + error), "{query}");
    }
}

#[test]
fn eval_problems_output_is_eval_pose_input() {
    let scene = scene();
    let make = "eval problems --posed posed --images images --map-list map.txt --query-list queries.txt \
                --max-keypoints 1024";
    scene.write("free.toml", "noise-px = 3\n");
    scene.write("fixed.toml", "noise-px = 3\nestimate-noise = false\n");
    for file in ["made.jsonl", "made.jsonl.gz"] {
        scene.run(&format!("{make} -o {file}")).succeeded();
        let run = scene.run(&format!("eval pose {file} --schemes points,dcl --json made.json")).succeeded();
        let document: serde_json::Value =
            serde_json::from_slice(&scene.read("made.json")).expect("a document");
        for row in document["schemes"].as_array().expect("an array") {
            assert_eq!(row["localized"], row["queries"], "{run}");
            assert_eq!(row["prior"], true, "ratio, votes and track length are there: {run}");
        }
        let of = |options: &str| {
            scene.run(&format!("eval pose {file} --schemes dcl --json fixed.json {options}")).succeeded();
            let document: serde_json::Value =
                serde_json::from_slice(&scene.read("fixed.json")).expect("a document");
            document["queries"][0]["translation_error"].as_f64().expect("a number")
        };
        let free = of("--estimator free.toml");
        assert_ne!(of("--estimator fixed.toml"), free);
    }
    assert_eq!(scene.read("made.jsonl.gz")[..2], [0x1f, 0x8b]);
    let refused = scene.run(&format!("{make} -o no/such/folder/made.jsonl"));
    assert_eq!(refused.code, Some(1), "{refused}");
}
