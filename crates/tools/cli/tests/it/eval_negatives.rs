//! `veiloc eval negatives`: out-of-map images, which must not be localized.

use super::common;

use std::collections::BTreeSet;

use common::{CAMERA, TestScene, render_out_of_map_images, scene};
use serde_json::Value;

const OUT_OF_MAP: usize = 6;

const ASK: &str = "eval negatives --map place.vmap --schemes points,dcl";

/// The scene, with images of another room in `other/images`, and with `mixed`: a blank image and a file that is not an
/// image.
fn ready() -> &'static TestScene {
    static READY: std::sync::Once = std::sync::Once::new();
    let scene = scene();
    READY.call_once(|| {
        render_out_of_map_images(OUT_OF_MAP);
        std::fs::create_dir_all(scene.path("mixed")).expect("folder");
        image::GrayImage::from_pixel(400, 300, image::Luma([90]))
            .save(scene.path("mixed/flat.png"))
            .expect("written");
        scene.write("mixed/notes.jpg", "no image");
        std::fs::copy(scene.path("other/images/negative-1.png"), scene.path("mixed/negative-1.png"))
            .expect("copied");
    });
    scene
}

fn document(bytes: &[u8]) -> Value {
    serde_json::from_slice(bytes).expect("a document")
}

fn rows(document: &Value) -> &Vec<Value> {
    document["rows"].as_array().expect("rows")
}

fn names(document: &Value) -> BTreeSet<&str> {
    document["queries"].as_array().expect("queries").iter().filter_map(|q| q["name"].as_str()).collect()
}

/// Tests of the engine cover the false positive rate; this test checks that similar rendered rooms are distinguished
/// from lines, and that all results are counted.
#[test]
fn out_of_map_images_are_counted() {
    let scene = ready();
    let run = scene.run(&format!("{ASK} --images other/images --json negatives.json")).succeeded();
    let found = document(&scene.read("negatives.json"));
    assert_eq!((&found["images"], &found["failed"]), (&OUT_OF_MAP.into(), &0.into()));
    let queries = found["queries"].as_array().expect("queries");
    assert_eq!((rows(&found).len(), queries.len()), (2, 2 * OUT_OF_MAP));
    for row in rows(&found) {
        let count = |of: &str| row[of].as_u64().expect("a count");
        let of_state = |state: &str| {
            queries.iter().filter(|q| q["scheme"] == row["scheme"] && q["state"] == state).count() as u64
        };
        let counts = [count("trusted"), count("doubtful"), count("not_found")];
        assert_eq!(counts, ["trusted", "doubtful", "not-found"].map(of_state), "{row}");
        assert_eq!((count("negatives"), counts.iter().sum(), count("unusable")), (6, 6, 0), "{row}");
        assert!(row["scheme"] == "points" || count("trusted") == 0, "{run}");
        assert_eq!((&row["cameras"]["given"], &row["cameras"]["assumed"]), (&0.into(), &OUT_OF_MAP.into()));
    }
    let given =
        scene.run(&format!("{ASK} --images other/images --camera {CAMERA} --json -")).succeeded().json();
    assert!(rows(&given).iter().all(|r| r["cameras"]["given"] == OUT_OF_MAP && r["cameras"]["assumed"] == 0));
}

/// With images of the scene itself the command shows false positives.
#[test]
fn images_of_the_scene_are_trusted_and_named() {
    let scene = ready();
    let run = scene.run(&format!("{ASK} --images images --camera {CAMERA} --json own.json")).succeeded();
    assert!(run.stdout.contains("Trusted (each is wrong):\n  "), "{run}");
    let own = document(&scene.read("own.json"));
    for row in rows(&own) {
        assert!(row["trusted"].as_u64() >= Some(12), "{row}");
        assert!(row["log_evidence"]["50"].as_f64() > Some(100.0), "{row}");
    }
    let query = &own["queries"][0];
    let center =
        query["center"].as_array().expect("a centre").iter().filter_map(Value::as_f64).collect::<Vec<_>>();
    let truth = scene.pose_of(query["name"].as_str().expect("a name")).center();
    assert!((0..3).all(|k| (center[k] - truth.coords[k]).abs() < 0.1), "{query}");
}

#[test]
fn split_depends_on_file_names_only() {
    let scene = ready();
    let of = |half: &str| {
        scene.run(&format!("{ASK} --images other/images --split {half} --json -")).succeeded().json()
    };
    let (design, last, all) = (of("design"), of("final"), of("all"));
    // The split depends on the hash of the names only.
    let expected: BTreeSet<&str> = DESIGN.into();
    assert_eq!(names(&design), expected);
    assert!(names(&design).is_disjoint(&names(&last)));
    assert_eq!(&names(&design) | &names(&last), names(&all));
    // The result of an image does not depend on the others.
    let of_all = |name: &Value| {
        let queries = all["queries"].as_array().expect("queries");
        queries.iter().filter(|q| q["name"] == *name).collect::<Vec<_>>()
    };
    for query in design["queries"].as_array().expect("queries") {
        assert!(of_all(&query["name"]).contains(&query), "{query}");
    }
    scene.write("one.txt", "negative-1.png\n");
    let empty = if expected.contains("negative-1.png") { "final" } else { "design" };
    let run = scene.run(&format!("{ASK} --images other/images --list one.txt --split {empty}"));
    assert!(run.code == Some(1) && run.stderr.contains("half"), "{run}");
}

#[test]
fn bad_images_are_named_without_stopping_others() {
    let scene = ready();
    let run = scene.run(&format!("{ASK} --images mixed --json mixed.json"));
    assert_eq!(run.code, Some(1), "{run}");
    assert!(run.stderr.contains("2 of 3 queried") && run.stderr.contains("notes.jpg"), "{run}");
    let mixed = document(&scene.read("mixed.json"));
    assert_eq!((&mixed["images"], &mixed["failed"]), (&3.into(), &1.into()));
    assert_eq!(
        (&mixed["errors"][0]["file"], &mixed["errors"][0]["kind"]),
        (&"notes.jpg".into(), &"damaged".into())
    );
    for row in rows(&mixed) {
        assert_eq!((&row["negatives"], &row["unusable"]), (&2.into(), &1.into()), "{row}");
    }
    scene.run(&format!("{ASK} --images mixed --skip-bad")).succeeded();

    let small = CAMERA.replace("400,300", "300,400");
    let cases: &[(&str, i32, &[&str])] = &[
        (&format!("--images other/images --camera {small}"), 1, &["400x300", "300x400"]),
        ("--images no/such/folder", 1, &["no/such/folder"]),
        ("--images other/images --list no-such.txt", 1, &["no-such.txt"]),
        ("--images other/images --split last", 2, &["design", "final"]),
        ("", 2, &["--images"]),
    ];
    for (arguments, code, expected_words) in cases {
        let run = scene.run(&format!("{ASK} {arguments}"));
        assert_eq!(run.code, Some(*code), "{run}");
        assert!(expected_words.iter().all(|word| run.stderr.contains(word)), "{run}");
    }
}

#[test]
fn result_is_independent_of_thread_count() {
    let scene = ready();
    let with = |threads: &str| {
        let mut command = scene.command(&format!("{ASK} --images other/images --json -"));
        command.env("RAYON_NUM_THREADS", threads).output().expect("runs").stdout
    };
    let one = with("1");
    assert!(!one.is_empty() && one == with("3"));
}

/// The design half of the rendered out-of-map images.
const DESIGN: [&str; 4] = ["negative-1.png", "negative-3.png", "negative-4.png", "negative-6.png"];
