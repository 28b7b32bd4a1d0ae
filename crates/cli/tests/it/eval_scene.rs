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

/// Images of what a server recovers that has localized the query, and of what it knows without an attack.
#[test]
fn eval_inversion_attacks_as_a_server() {
    let scene = scene();
    let learned = concat!(env!("CARGO_MANIFEST_DIR"), "/../research/attacks/tests/data/learned");
    scene
        .run(
            "eval problems --posed posed --images images --map-list map.txt --query-list queries.txt --features sift \
             --max-keypoints 1024 --query-keypoints 512 -o sift.jsonl --keypoints sift-keypoints.jsonl",
        )
        .succeeded();
    let eval = format!(
        "eval inversion images --list queries.txt --limit 2 --network {learned}/plain.toml --features sift \
         --schemes dcl,dcl:random -k 5"
    );
    let known = "--keypoints sift-keypoints.jsonl --server-matches sift.jsonl --json inverted.json";
    scene.run(&format!("{eval} {known}")).succeeded();
    let document: serde_json::Value =
        serde_json::from_slice(&scene.read("inverted.json")).expect("a document");
    for scheme in ["dcl", "dcl:random"] {
        let row = |attack: &str| {
            let rows = document["summary"].as_array().expect("rows").iter();
            rows.filter(|row| row["scheme"] == scheme)
                .find(|row| row["attack"] == attack)
                .expect(attack)
                .clone()
        };
        assert!(row("matched")["mean_px"].is_null(), "nothing is recovered");
        for attack in ["matched", "server-side", "iterative", "occlusion"] {
            let psnr =
                row(attack)["private_psnr"].as_f64().expect("in the box of what the map does not explain");
            assert!(psnr > 5.0 && psnr < 60.0, "{document}");
        }
        assert!(row("server-side")["mean_px"].as_f64().expect("positions") > 0.5, "{document}");
        assert!(row("graph").get("private_psnr").is_none(), "without a server");
    }
    scene.write("one.txt", "map-00.png\n");
    let refused = scene.run(&format!("{} {known}", eval.replace("queries.txt", "one.txt")));
    assert_eq!(refused.code, Some(1), "{refused}");
    assert!(
        refused.stderr.contains("sift-keypoints.jsonl") && refused.stderr.contains("map-00.png"),
        "{refused}"
    );
}

/// Map images that another program retrieved.
#[test]
fn eval_scene_takes_pairs_of_hloc() {
    let scene = scene();
    let eval = "eval scene --posed posed --images images --map-list map.txt --query-list queries.txt \
                --max-keypoints 1024 --query-keypoints 512 --schemes dcl --json pairs.json";
    let evaluated = |more: &str| {
        scene.run(&format!("{eval} {more}")).succeeded();
        serde_json::from_slice::<serde_json::Value>(&scene.read("pairs.json")).expect("a document")["queries"]
            .clone()
    };
    let text = |name: &str| String::from_utf8(scene.read(name)).expect("text");
    let (map, queries) = (text("map.txt"), text("queries.txt"));
    let names =
        |list: &str| list.lines().map(|l| l.split(' ').next().unwrap_or("").to_owned()).collect::<Vec<_>>();
    let (map, queries) = (names(&map), names(&queries));
    let pairs = |images: &[&str]| {
        let lines = queries.iter().flat_map(|q| images.iter().map(move |image| format!("{q} {image}\n")));
        scene.write("pairs.txt", lines.collect::<String>());
    };
    // All map images in any order: as many matches as possible; one alone: fewer.
    pairs(&map.iter().map(String::as_str).collect::<Vec<_>>());
    let all = evaluated("--pairs pairs.txt");
    pairs(&[&map[0], "gone.png"]);
    let one = scene.run(&format!("{eval} --pairs pairs.txt"));
    assert!(one.stderr.contains("pairs.txt: ") && one.stderr.contains("not mapped"), "{one}");
    let one: serde_json::Value = serde_json::from_slice(&scene.read("pairs.json")).expect("a document");
    for (at, own) in evaluated("").as_array().expect("rows").iter().enumerate() {
        let count = |rows: &serde_json::Value| rows[at]["correspondences"].as_u64().unwrap_or(0);
        assert_eq!(all[at]["state"], "trusted", "{all}");
        assert!(
            count(&all) >= own["correspondences"].as_u64().expect("a count")
                && count(&one["queries"]) < count(&all)
        );
    }
    scene.write("pairs.txt", format!("{} {}\n", queries[0], map[0]));
    let refused = scene.run(&format!("{eval} --pairs pairs.txt"));
    assert_eq!(refused.code, Some(1), "{refused}");
    assert!(refused.stderr.contains(&queries[1]) && refused.stderr.contains("pairs"), "{refused}");
    scene.write("pairs.txt", "one\n");
    let refused = scene.run(&format!("{eval} --pairs pairs.txt"));
    assert!(refused.code == Some(1) && refused.stderr.contains("pairs.txt"), "{refused}");
}
