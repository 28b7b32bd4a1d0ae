//! `veiloc eval scene --conditions`: queries under hard conditions, several images together, and out-of-map images.

use super::common;

use std::collections::BTreeSet;

use common::{CAMERA, QUERIES, TestScene, render_out_of_map_images, scene};
use serde_json::Value;

const SCENE: &str = "eval scene --posed posed --images images --map-list map.txt --query-list queries.txt \
                     --max-keypoints 512 --query-keypoints 512 --schemes points,dcl";

const NEGATIVES: usize = 6;

/// Out-of-map images in a map that was built before.
const IN_MAP: &str = "eval scene --map place.vmap --schemes points,dcl --conditions negatives";

/// The design half of the rendered out-of-map images, which depends on the hash of their names only.
const DESIGN: [&str; 4] = ["negative-1.png", "negative-3.png", "negative-4.png", "negative-6.png"];

fn document(scene: &TestScene, arguments: &str) -> Value {
    scene.run(&format!("{arguments} --json -")).succeeded().json()
}

fn list<'a>(document: &'a Value, of: &str) -> &'a [Value] {
    document[of].as_array().unwrap_or_else(|| panic!("no {of}"))
}

/// The entries of a condition, without the condition.
fn under<'a>(document: &'a Value, of: &str, condition: Option<&str>) -> Vec<&'a Value> {
    list(document, of).iter().filter(|entry| entry["condition"].as_str() == condition).collect()
}

/// The entries without times and the condition.
fn figures(entries: &[&Value]) -> Vec<Value> {
    let without = |entry: &&Value| {
        let mut entry = (*entry).clone();
        let fields = entry.as_object_mut().expect("an object");
        fields.retain(|name, _| !["ms", "median_ms", "condition"].contains(&name.as_str()));
        entry
    };
    entries.iter().map(without).collect()
}

#[test]
fn every_condition_has_rows_in_the_given_order() {
    let scene = scene();
    let conditions =
        "none,dark,motion,half-hidden,side-hidden,low-resolution,sparse-map,few-keypoints,camera:cx+5%";
    let run = scene.run(&format!("{SCENE} --conditions {conditions} --optimum --json hard.json")).succeeded();
    assert!(run.stdout.contains("floor") && run.stderr.contains("one image in 3, 4 images"), "{run}");
    let result: Value = serde_json::from_slice(&scene.read("hard.json")).expect("a document");
    let rows = list(&result, "schemes");
    let name = |row: &'_ Value| row["condition"].as_str().unwrap_or("none").to_owned();
    // Each scheme has the row of the search and two from the true pose.
    assert_eq!(rows.iter().map(name).step_by(6).collect::<Vec<_>>().join(","), conditions);
    let stride_and_images = (&result["sparse_map"]["stride"], &result["sparse_map"]["images"]);
    assert_eq!(stride_and_images, (&3.into(), &4.into()));
    for row in rows {
        assert_eq!(row["queries"], QUERIES, "{row}");
        if row["condition"].is_null() {
            assert_eq!(row["recall"]["0.25/2"], 1.0, "{row}");
        }
        assert_eq!(row["trusted"].is_null(), row["recipe"] != "default", "{row}");
    }
    let sum = |field: &str, condition: Option<&str>| -> u64 {
        let of_points = |query: &&&Value| query["scheme"] == "points" && query["recipe"] == "default";
        let queries = under(&result, "queries", condition);
        queries.iter().filter(of_points).filter_map(|query| query[field].as_u64()).sum()
    };
    for condition in conditions.split(',').skip(1).filter(|condition| !condition.starts_with("camera")) {
        assert!(sum("inliers", Some(condition)) < sum("inliers", None), "{condition} reduces the inliers");
    }
    assert!(sum("sent_rows", Some("few-keypoints")) <= 256 * QUERIES as u64);
}

#[test]
fn a_row_does_not_depend_on_other_conditions() {
    let scene = scene();
    let alone = document(scene, &format!("{SCENE} --seed 3"));
    let several = document(
        scene,
        &format!("{SCENE} --seed 3 --conditions dark,none,gravity:0.5,sparse-map+gravity:0.5"),
    );
    for of in ["schemes", "queries"] {
        let plain = figures(&under(&several, of, None));
        assert_eq!(plain, figures(&under(&alone, of, None)), "{of}");
        assert_ne!(plain, figures(&under(&several, of, Some("gravity:0.5"))), "{of}");
        assert_eq!(under(&several, of, Some("sparse-map+gravity:0.5")).len(), plain.len());
    }
}

#[test]
fn images_together_have_the_same_queries() {
    let scene = scene();
    let conditions = "--conditions frames:1,frames:2,dark+frames:2 --max-distance 9";
    let result = document(scene, &format!("{SCENE} {conditions}"));
    let names = |condition| -> Vec<&Value> {
        under(&result, "queries", Some(condition)).iter().map(|query| &query["name"]).collect()
    };
    assert!(names("frames:1").len() >= 2);
    assert_eq!(names("frames:1"), names("frames:2"));
    assert_eq!(names("frames:1"), names("dark+frames:2"));
    let pairs = |condition| under(&result, "queries", Some(condition))[0]["correspondences"].as_u64();
    assert!(pairs("frames:2") > pairs("frames:1"));
}

#[test]
fn equal_seeds_give_equal_results_for_any_number_of_threads() {
    let scene = scene();
    render_out_of_map_images(NEGATIVES);
    let with = |jobs: u32, seed: u32| {
        let more = "--conditions motion,frames:2,negatives --max-distance 9 --negatives other/images";
        let result = document(scene, &format!("{SCENE} {more} --seed {seed} --jobs {jobs}"));
        figures(&list(&result, "queries").iter().collect::<Vec<_>>())
    };
    let one = with(1, 5);
    assert_eq!(one, with(3, 5));
    assert_ne!(one, with(3, 6));
}

/// The results of a condition are found again when others are added.
#[test]
fn conditions_are_stored_separately() {
    let scene = scene();
    let run =
        |conditions: &str| document(scene, &format!("{SCENE} --conditions {conditions} --work conditions"));
    let first = run("none,dark");
    let lines = || String::from_utf8(scene.read("conditions/queries.jsonl")).expect("text").lines().count();
    assert_eq!(lines(), 2 * QUERIES);
    let more = run("sparse-map,dark,none");
    assert_eq!(lines(), 3 * QUERIES);
    for condition in [None, Some("dark")] {
        assert_eq!(under(&more, "queries", condition), under(&first, "queries", condition));
    }
}

/// Tests of the engine cover the false positive rate; this test checks that similar rendered rooms are distinguished
/// from lines, and that all results are counted.
#[test]
fn out_of_map_images_are_counted() {
    let scene = scene();
    render_out_of_map_images(NEGATIVES);
    let found = document(scene, &format!("{IN_MAP} --negatives other/images"));
    let queries = list(&found, "queries");
    assert_eq!((list(&found, "schemes").len(), queries.len()), (2, 2 * NEGATIVES));
    assert!(queries.iter().all(|query| query["focal"] == "unknown" && query["has_ground_truth"] == false));
    for row in list(&found, "schemes") {
        let count = |of: &str| row[of].as_u64().expect("a count");
        let of_state = |state: &str| {
            queries.iter().filter(|q| q["scheme"] == row["scheme"] && q["state"] == state).count() as u64
        };
        let counts = [count("trusted"), count("doubtful"), count("not_found")];
        assert_eq!(counts, ["trusted", "doubtful", "not-found"].map(of_state), "{row}");
        assert_eq!((count("queries"), counts.iter().sum()), (NEGATIVES as u64, NEGATIVES as u64), "{row}");
        assert!(row["scheme"] == "points" || count("trusted") == 0, "{row}");
        assert_eq!(count("trusted_wrong"), count("trusted"), "{row}");
    }
    // An image that cannot be read is left out, and said.
    let png = scene.read("other/images/negative-1.png");
    scene.write("damaged/cut.png", &png[..png.len() / 2]);
    scene.write("damaged/whole.png", &png);
    let run = scene.run(&format!("{IN_MAP} --negatives damaged --json")).succeeded();
    assert_eq!(run.json()["schemes"][0]["queries"], 1, "{run}");
    assert!(run.stderr.contains("1 of 2 out-of-map images") && run.stderr.contains("cut.png"), "{run}");
    // Beside the scene's own queries, and sent progressively.
    let both = document(
        scene,
        &format!(
            "{SCENE} --conditions none,negatives --negatives other/images --negatives-camera {CAMERA} --progressive"
        ),
    );
    for row in under(&both, "schemes", Some("negatives")) {
        assert_eq!((&row["queries"], &row["trusted"]), (&NEGATIVES.into(), &0.into()), "{row}");
    }
    assert!(under(&both, "queries", Some("negatives")).iter().all(|query| query["focal"] == "calibrated"));
    assert!(under(&both, "schemes", None).iter().all(|row| row["trusted"].as_u64() >= Some(2)));
}

/// With images of the scene itself there are false positives.
#[test]
fn images_of_the_scene_are_trusted() {
    let scene = scene();
    let own = document(scene, &format!("{IN_MAP} --negatives images --negatives-camera {CAMERA}"));
    for row in list(&own, "schemes") {
        assert!(row["trusted_wrong"].as_u64() >= Some(12), "{row}");
    }
    let query = &own["queries"][0];
    assert!(query["log_evidence"].as_f64() > Some(100.0), "{query}");
    let found = common::pose(&query["cam_from_world"]);
    assert!(scene.position_error(query["name"].as_str().expect("a name"), &found) < 0.1, "{query}");
}

#[test]
fn halves_depend_on_file_names_only() {
    let scene = scene();
    render_out_of_map_images(NEGATIVES);
    let of =
        |half: &str| document(scene, &format!("{IN_MAP} --negatives other/images --negatives-split {half}"));
    let (design, last, all) = (of("design"), of("final"), of("all"));
    fn names(document: &Value) -> BTreeSet<&str> {
        list(document, "queries").iter().filter_map(|query| query["name"].as_str()).collect()
    }
    assert_eq!(names(&design), DESIGN.into());
    assert!(names(&design).is_disjoint(&names(&last)));
    assert_eq!(&names(&design) | &names(&last), names(&all));
    // The result of an image does not depend on the others.
    let of_all = figures(&list(&all, "queries").iter().collect::<Vec<_>>());
    let of_design = figures(&list(&design, "queries").iter().collect::<Vec<_>>());
    assert!(of_design.iter().all(|query| of_all.contains(query)));
}

#[test]
fn invalid_arguments_are_refused() {
    let scene = scene();
    render_out_of_map_images(NEGATIVES);
    scene.write("both.txt", "query-0.png\nmap-00.png\n");
    scene.write("one.txt", "negative-1.png\n");
    scene.write("notes/notes.jpg", "no image");
    let small = CAMERA.replace("400,300", "300,400");
    let given = "eval scene --posed posed --images images --map-list map.txt --query-list";
    let cases: &[(&str, i32, &[&str])] = &[
        (&format!("{SCENE} --conditions light"), 2, &["light", "half-hidden"]),
        (&format!("{SCENE} --conditions negatives+frames:2"), 2, &["single images"]),
        (&format!("{SCENE} --conditions dark,none,dark"), 1, &["occurs twice"]),
        (&format!("{SCENE} --conditions gravity:17"), 1, &["gravity", "16"]),
        (&format!("{SCENE} --conditions frames:2 --estimator paper"), 1, &["uses the likelihood"]),
        (&format!("{SCENE} --conditions frames:9"), 1, &["no 9 queries"]),
        (&format!("{SCENE} --conditions dark --report dark.html"), 1, &["--conditions"]),
        (&format!("{SCENE} --oracle-radius 0"), 2, &["above 0"]),
        (&format!("{SCENE} --conditions negatives"), 1, &["out-of-map images"]),
        (&format!("{SCENE} --negatives other/images"), 1, &["out-of-map images"]),
        (&format!("{SCENE} --conditions negatives --negatives images"), 1, &["evaluated scene"]),
        (&format!("{given} both.txt --max-keypoints 256"), 1, &["map-00.png", "must not be in the map"]),
        (&format!("{given} no-such.txt"), 1, &["no-such.txt"]),
        ("eval scene --schemes dcl", 1, &["--query-list"]),
        ("eval scene --map place.vmap", 2, &["--negatives"]),
        ("eval scene --map place.vmap --negatives other/images", 1, &["negatives"]),
        (&format!("{IN_MAP},dark --negatives other/images"), 1, &["only the condition"]),
        (&format!("{IN_MAP}+gravity:0.5 --negatives other/images"), 1, &["no direction of gravity"]),
        (
            &format!("{IN_MAP} --negatives other/images --negatives-camera {small}"),
            1,
            &["400 x 300", "300 x 400"],
        ),
        (&format!("{IN_MAP} --negatives no/such/folder"), 1, &["no/such/folder"]),
        (&format!("{IN_MAP} --negatives notes"), 1, &["notes.jpg"]),
        (&format!("{IN_MAP} --negatives other/images --negatives-list no-such.txt"), 1, &["no-such.txt"]),
        (&format!("{IN_MAP} --negatives other/images --negatives-split last"), 2, &["design", "final"]),
        (
            &format!("{IN_MAP} --negatives other/images --negatives-list one.txt --negatives-split final"),
            1,
            &["half"],
        ),
    ];
    for (arguments, code, expected_words) in cases {
        let run = scene.run(arguments);
        assert_eq!(run.code, Some(*code), "{run}");
        assert!(
            run.stdout.is_empty() && expected_words.iter().all(|word| run.stderr.contains(word)),
            "{run}"
        );
    }
}
