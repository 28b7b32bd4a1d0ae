//! `veiloc eval pose` for research: estimators, seeds, gravity, the floor.

use super::common;

use common::{Run, TestScene, folder, keys};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use veiloc_geometry::nalgebra::Vector3;
use veiloc_synthetic::problems::{PointProblem, PointProblemOptions};

/// Number of queries in the file that every test reads.
const QUERIES: usize = 4;

/// Matches with a third of outliers, half a pixel of noise, and weakly informative ratios.
fn problems(gravity: bool) -> String {
    let mut lines = String::new();
    for index in 0..QUERIES {
        let mut rng = ChaCha8Rng::seed_from_u64(40 + index as u64);
        let options = PointProblemOptions::exact(300).outliers(0.33).noise(0.5);
        let problem = PointProblem::generate(&options, &mut rng);
        let pose = &problem.cam_from_world;
        let t = pose.translation();
        let ratios: Vec<f64> = problem.inliers.iter().map(|right| if *right { 0.6 } else { 0.9 }).collect();
        let mut line = json!({
            "name": format!("q{index}"),
            "camera": {"model": "PINHOLE", "width": 640, "height": 480, "params": [525, 525, 320, 240]},
            "points2d": problem.pixels.iter().map(|p| [p.u, p.v]).collect::<Vec<_>>(),
            "points3d": problem.points.iter().map(|p| [p.coords.x, p.coords.y, p.coords.z]).collect::<Vec<_>>(),
            "cam_from_world": {"q": pose.quaternion(), "t": [t.x, t.y, t.z]},
            "ratio": ratios,
        });
        if gravity {
            let down = pose.rotation() * Vector3::new(0.0, 0.0, -1.0);
            line["gravity_in_camera"] = json!([down.x, down.y, down.z]);
        }
        lines += &line.to_string();
        lines.push('\n');
    }
    lines
}

/// A folder with the problems, without a rendered scene.
fn scene() -> TestScene {
    let scene = folder();
    scene.write("problems.jsonl", problems(false));
    scene.write("gravity.jsonl", problems(true));
    scene
}

fn rows(document: &Value) -> Vec<&Value> {
    document["schemes"].as_array().expect("an array").iter().collect()
}

fn document(scene: &TestScene, arguments: &str) -> Value {
    scene.run(&format!("eval pose {arguments} --json")).succeeded().json()
}

#[test]
fn estimators_are_compared_on_the_same_matches() {
    let scene = scene();
    for base in ["likelihood", "vote"] {
        for count in [50, 300] {
            let file = format!("base = {base:?}\nhypotheses = {count}\n");
            scene.write(&format!("{base}-{count}.toml"), file);
        }
    }
    let document = document(
        &scene,
        "problems.jsonl --schemes points,dcl \
         --estimator likelihood-50.toml,likelihood-300.toml,vote-50.toml,vote-300.toml,floor --thresholds 0.05/1",
    );
    let reported: Vec<String> = rows(&document)
        .iter()
        .map(|row| {
            format!("{} {} {}", row["scheme"], row["recipe"], row["fixed_hypotheses"]).replace('"', "")
        })
        .collect();
    let expected = |scheme: &str| {
        ["likelihood-50 50", "likelihood-300 300", "vote-50 50", "vote-300 300", "floor null"]
            .map(|r| format!("{scheme} {r}"))
    };
    assert_eq!(reported, [expected("points"), expected("dcl")].concat());
    for row in rows(&document) {
        assert_eq!(row["queries"], QUERIES, "{row}");
        let floor = row["recipe"] == "floor";
        assert_eq!(row["score"] == "least-squares", floor, "{row}");
        let votes = row["recipe"].as_str().is_some_and(|name| name.starts_with("vote"));
        assert_eq!(row["prior"], votes, "{row}");
        assert!(row.get("per_seed").is_none() && row.get("gravity").is_none(), "{row}");
        assert_eq!(row["median_hypotheses"].is_null(), floor, "{row}");
    }
    // The floor knows which matches are correct: two thirds of 300.
    let floor = &document["queries"].as_array().expect("an array").last().expect("at least one row");
    assert_eq!(floor["recipe"], "floor");
    assert!((190..=210).contains(&floor["inliers"].as_u64().expect("a number")), "{floor}");
    assert!(floor["translation_error"].as_f64().expect("found") < 0.05, "{floor}");
    assert!(document["fixed_hypotheses"].is_null(), "rows differ");
}

#[test]
fn seeds_give_mean_and_spread() {
    let scene = scene();
    let arguments = "problems.jsonl --schemes random-lines --seeds 3 --seed 5 --thresholds 0.02/1,0.5/5";
    let run = document(&scene, arguments);
    let row = rows(&run)[0];
    assert_eq!(row["queries"], 3 * QUERIES);
    let per_seed = row["per_seed"].as_array().expect("an array");
    assert_eq!(per_seed.iter().map(|s| s["seed"].as_u64()).collect::<Vec<_>>(), [Some(5), Some(6), Some(7)]);
    let mean: f64 =
        per_seed.iter().map(|s| s["recall"]["0.02/1"].as_f64().expect("a share")).sum::<f64>() / 3.0;
    assert!((row["recall"]["0.02/1"].as_f64().expect("a share") - mean).abs() < 1e-12);
    let medians: Vec<_> = per_seed.iter().map(|s| s["median_translation"].to_string()).collect();
    assert!(
        medians[0] != medians[1] && medians[1] != medians[2],
        "every seed draws its own lines: {medians:?}"
    );

    // A single seed gives the same result as within a series, and many threads the same as one.
    let alone = document(&scene, &arguments.replace("--seeds 3 --seed 5", "--seed 6"));
    assert_eq!(rows(&alone)[0]["median_translation"], per_seed[1]["median_translation"]);
    assert!(rows(&alone)[0].get("per_seed").is_none());
    let threads = document(&scene, &format!("{arguments} --threads 3"));
    assert_eq!(rows(&threads)[0]["per_seed"][2]["recall"], per_seed[2]["recall"]);
    assert_eq!(rows(&threads)[0]["median_translation"], row["median_translation"]);

    let table = scene.run(&format!("eval pose {arguments}")).succeeded().stdout;
    assert!(table.contains("Means over 3 seeds") && table.contains(".."), "{table}");
    assert!(table.lines().all(|line| line.chars().count() <= 120), "{table}");
}

#[test]
fn gravity_comes_from_file_or_true_pose() {
    let scene = scene();
    let reported = |arguments: &str| -> Vec<Value> {
        let document = document(&scene, &format!("{arguments} --schemes points"));
        rows(&document).iter().map(|row| row["gravity"].clone()).collect()
    };
    assert_eq!(reported("problems.jsonl"), [Value::Null], "no gravity requested, and none in the file");
    assert_eq!(reported("gravity.jsonl"), ["file"]);
    assert_eq!(reported("problems.jsonl --gravity none,0,3"), ["none", "0", "3"]);
    let table = scene.run("eval pose gravity.jsonl --schemes points --gravity none,file").succeeded().stdout;
    assert!(table.contains("gravity °"), "{table}");
    let without = scene.run("eval pose problems.jsonl --schemes points").succeeded().stdout;
    assert!(!without.contains("gravity") && !without.contains("recipe"), "no empty column: {without}");
}

#[test]
fn contradictory_arguments_are_refused() {
    let scene = scene();
    scene.write("wrong.toml", "base = \"paper\"\nscor = \"msac\"\n");
    scene.write("down.jsonl", problems(true).replacen("gravity_in_camera", "gravity_in_world", 1));
    let cases: &[(&str, i32, &[&str])] = &[
        ("problems.jsonl --estimator best", 2, &["best", "likelihood+prior"]),
        ("problems.jsonl --estimator paper,vote,paper", 1, &["paper", "name"]),
        ("problems.jsonl --estimator none.toml", 2, &["none.toml", "check the path"]),
        ("problems.jsonl --estimator wrong.toml", 2, &["wrong.toml", "line 2", "scor", "`score`"]),
        ("problems.jsonl --seeds 0", 2, &["--seeds"]),
        ("problems.jsonl --gravity down", 2, &["down", "degrees"]),
        ("problems.jsonl --oracle-radius 0", 2, &["above 0"]),
        ("down.jsonl", 1, &["down.jsonl:1", "gravity_in_world"]),
    ];
    for (arguments, code, expected_words) in cases {
        let run: Run = scene.run(&format!("eval pose {arguments}"));
        assert_eq!(run.code, Some(*code), "{run}");
        assert!(
            run.stdout.is_empty() && expected_words.iter().all(|word| run.stderr.contains(word)),
            "{run}"
        );
    }
}

#[test]
fn document_fields_are_stable() {
    let scene = scene();
    scene.write("fixed.toml", "hypotheses = 300\n");
    let document = document(&scene, "problems.jsonl --schemes dcl --estimator fixed.toml");
    assert_eq!(
        keys(&document),
        ["command", "data", "fixed_hypotheses", "prior", "queries", "schemes", "seed", "version"]
    );
    assert_eq!((&document["version"], &document["fixed_hypotheses"]), (&json!(1), &json!(300)));
    for key in
        ["scheme", "queries", "localized", "median_rotation_deg", "median_translation", "recall", "median_ms"]
    {
        assert!(rows(&document)[0].get(key).is_some(), "{key}: {document}");
    }
    for key in ["name", "scheme", "rotation_error_deg", "translation_error", "inliers", "hypotheses", "ms"] {
        assert!(document["queries"][0].get(key).is_some(), "{key}: {document}");
    }
    assert!(document["queries"][0]["state"].is_string(), "{document}");
}
