//! `--hide`: detected objects are not sent, and an unusable detector prevents sending.

use super::common;

use common::{CAMERA, TestScene, scene};

/// Finds a person in the left half of any image (`research/oracles/detector.py`).
fn detector(name: &str) -> String {
    format!("{}/../device/features/tests/data/detector/{name}.onnx", env!("CARGO_MANIFEST_DIR"))
}

fn seal(more: &str) -> String {
    format!("seal images/query-0.png --camera {CAMERA} --profile place.vprofile -o hidden.vquery {more}")
}

/// The command exits with 1, prints all these words, and writes no query.
fn refused(scene: &TestScene, command: &str, expected_words: &[&str]) {
    let run = scene.run(&command.replace("hidden.vquery", "none.vquery")).refused(expected_words);
    assert!(!scene.path("none.vquery").exists(), "{run}");
}

#[test]
fn detections_are_hidden_and_reported() {
    let scene = scene();
    let hidden = |more: &str| {
        let run = scene.run(&format!("{} --json", seal(more))).succeeded();
        let fields = &common::documented::tables()["seal"];
        assert_eq!(common::documented::mistakes(fields, &[run.json()]), [""; 0]);
        (run.json()["images"][0].clone(), run)
    };
    let (all, _) = hidden("");
    assert!(all["masked"].is_null() && all["detections"].is_null());
    let (person, run) = hidden(&format!("--hide person --detector {}", detector("two-boxes")));
    assert_eq!(person["detections"], serde_json::json!({"person": 1}), "cars were not requested");
    // Columns 62.5 to 137.5 and rows 25 to 275 of 400 x 300, with 0.15 of each to both sides.
    assert_eq!(person["masked"], 98.0 / 400.0, "{run}");
    assert!(run.stderr.contains("found 1 × person, 24.5 % of the image hidden"), "{run}");
    assert!(person["keypoints"].as_u64() < all["keypoints"].as_u64());
    let (wide, _) = hidden(&format!("--hide person --detector {} --hide-margin 0.5", detector("two-boxes")));
    assert_eq!(wide["masked"], 150.0 / 400.0);
    let (both, run) = hidden(&format!("--hide person,car --detector {}", detector("two-boxes")));
    assert_eq!(both["detections"], serde_json::json!({"car": 1, "person": 1}), "{run}");
    assert!(both["masked"].as_f64() > person["masked"].as_f64());
}

fn segmenter(name: &str) -> String {
    format!("{}/../device/features/tests/data/segmenter/{name}.tflite", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn people_are_hidden_and_their_absence_is_reported() {
    let scene = scene();
    // Rendered places are gray: what the network takes for people, red, is painted.
    let painted = |name: &str, columns: u32| {
        let image = image::open(scene.path("images/query-0.png")).expect("an image").into_luma8();
        let mut image = image::DynamicImage::from(image).into_rgb8();
        for (x, y) in (0..columns).flat_map(|x| (0..150).map(move |y| (x, y))) {
            image.put_pixel(x, y, image::Rgb([250, 10, 20]));
        }
        image.save(scene.path(name)).expect("written");
    };
    painted("nobody.png", 0);
    painted("somebody.png", 100);
    let file = segmenter("red");
    let run = |image: &str, more: &str| {
        let seal = seal(&format!("--hide people {more} --json")).replace("images/query-0.png", image);
        let mut command = scene.command(&seal);
        command.env("XDG_DATA_HOME", scene.path("data-home"));
        common::Run::of(&seal, &command.output().expect("the binary runs"))
    };
    let none = run("nobody.png", &format!("--detector {file}")).succeeded();
    assert!(none.stderr.contains("0 people found: nothing was hidden, "), "{none}");
    assert_eq!(none.json()["images"][0]["detections"], serde_json::json!({"people": 0}), "{none}");
    assert!(none.json()["images"][0]["masked"].is_null(), "{none}");
    let some = run("somebody.png", &format!("--detector {file}")).succeeded();
    assert!(some.stderr.contains("people found in 1 region, "), "{some}");
    // A quarter of the width and half of the height, and the margin.
    let share = some.json()["images"][0]["masked"].as_f64().expect("a share");
    assert!((0.125..0.16).contains(&share), "{some}");
    let wide = run("somebody.png", &format!("--detector {file} --hide-margin 0.1")).succeeded();
    assert!(wide.json()["images"][0]["masked"].as_f64() > Some(share), "{wide}");
    // Without --detector: the user's copy, or how to get it.
    let source = ["is missing", "npm pack @mediapipe/selfie_segmentation", "Apache-2.0", "8d13b7fa"];
    run("somebody.png", "").refused(&source);
    std::fs::create_dir_all(scene.path("data-home/veiloc")).expect("a folder");
    std::fs::copy(&file, scene.path("data-home/veiloc/selfie_segmentation.tflite")).expect("copied");
    assert_eq!(run("somebody.png", "").succeeded().json(), some.json());
    let all = scene.run(&seal(&format!("--hide people --detector {}", segmenter("tiny"))));
    assert!(all.code == Some(1) && all.stderr.contains("hides the whole image"), "{all}");
}

#[test]
fn unusable_detector_sends_nothing() {
    let scene = scene();
    let whole = std::fs::read(detector("two-boxes")).expect("a detector");
    scene.write("cut.onnx", &whole[..whole.len() / 2]);
    let with = |classes: &str, file: &str| seal(&format!("--hide {classes} --detector {file}"));
    let good = detector("two-boxes");
    for (command, expected_words) in [
        (with("dog", &good), &["no class dog", "its classes: person, car"][..]),
        (with("Person", &good), &["no class Person", "person, car"]),
        (with("person", "gone.onnx"), &["gone.onnx", "cannot read the detector"]),
        (with("person", "cut.onnx"), &["cut.onnx", "this detector cannot be used"]),
        (with("person", "place.vprofile"), &["place.vprofile", "this detector cannot be used"]),
        (with("person", &detector("no-names")), &["names of its classes"]),
        (seal("--hide person"), &["--hide person needs a detector", "--detector", "--hide people"]),
        (with("people", &good), &["no class people"]),
        (with("person", &detector("not-a-number")), &["query-0.png", "could not run"]),
        (with("person", &good).replace("-o hidden.vquery", &format!("-o {good}")), &["is an input"]),
    ] {
        refused(scene, &command, expected_words);
    }
    // The error comes before any request: there is no service at this address.
    let send =
        format!("query send images/query-0.png --camera {CAMERA} --map place --server http://127.0.0.1:9");
    refused(scene, &format!("{send} --hide dog --detector {good}"), &["no class dog"]);
    refused(
        scene,
        &format!("{send} --hide person --detector {}", detector("not-a-number")),
        &["could not run"],
    );
    for (more, part) in [
        (format!("--detector {good}"), "--hide"),
        (format!("--hide person --detector {good} --hide-margin=-1"), "0 to 1"),
        (format!("--hide person --detector {good} --hide-margin nan"), "0 to 1"),
    ] {
        let run = scene.run(&seal(&more));
        assert!(run.code == Some(2) && run.stderr.contains(part), "{part}: {run}");
    }
}
