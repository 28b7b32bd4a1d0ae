//! `--report` of `eval scene`, the data-set commands and `localize`: one complete file, and unchanged documents.

use super::common;

use common::{TestScene, scene};
use serde_json::Value;

const SCENE: &str = "eval scene --posed posed --images images --map-list map.txt --query-list queries.txt \
                     --max-keypoints 512 --query-keypoints 512 --schemes points,dcl --keep-map report.vmap";

/// A report, with the checks that hold for every report.
fn page(scene: &TestScene, name: &str) -> String {
    let page = String::from_utf8(scene.read(name)).expect("UTF-8");
    assert!(page.starts_with("<!DOCTYPE html>") && page.ends_with("</html>"), "{name}");
    assert!(
        page.contains("Content-Security-Policy\" content=\"default-src 'none'; img-src data:;"),
        "{name}"
    );
    for mark in ["http:", "https:", "src=", " style="] {
        let body = page.split("<body>").nth(1).expect("a body");
        assert!(!body.contains(mark), "{name}: {mark}");
    }
    assert!(
        page.contains("data-part=\"canvas\"") && page.contains("\"points\":\""),
        "{name}: no scene in 3D"
    );
    page
}

/// A document without the fields that differ from run to run.
fn document(scene: &TestScene, name: &str) -> Value {
    fn timeless(value: &mut Value) {
        match value {
            Value::Object(fields) => {
                fields.retain(|name, _| !matches!(name.as_str(), "ms" | "median_ms" | "build_seconds"));
                fields.values_mut().for_each(timeless);
            }
            Value::Array(items) => items.iter_mut().for_each(timeless),
            _ => {}
        }
    }
    let mut document = serde_json::from_slice(&scene.read(name)).expect("a document");
    timeless(&mut document);
    document
}

#[test]
fn scene_report_leaves_document_unchanged() {
    let scene = scene();
    scene.run(&format!("{SCENE} --json without.json")).succeeded();
    let run = scene.run(&format!("{SCENE} --json with.json --report scene.html")).succeeded();
    assert!(run.stderr.contains("report: scene.html"), "{run}");
    assert_eq!(document(scene, "without.json"), document(scene, "with.json"));
    let text = page(scene, "scene.html");
    assert_eq!(text.matches("<details class=\"fold\" id=\"query-").count(), 3);
    assert_eq!(text.matches("data:image/jpeg").count(), 3);
    assert!(text.contains("contains 3 complete query images"));
    // Rows of points and of half-lines, some of them inliers; one line belongs to the legend.
    assert_eq!(text.matches("class=\"line inlier\" d=\"M").count(), 3 + 1);
    assert_eq!(text.matches("class=\"dot inlier\" d=\"M").count(), 3);
    // The unit of a COLMAP model is unknown.
    assert!(text.contains("map units") && !text.contains(" cm<"));

    let few = "--report few.html --report-queries 1 --report-without-images";
    scene.run(&format!("{SCENE} {few}")).succeeded();
    let text = page(scene, "few.html");
    assert_eq!(text.matches("<details class=\"fold\" id=\"query-").count(), 1);
    assert!(!text.contains("data:image") && text.contains("but no images"));
    assert!(text.contains("Queries that are not drawn"));

    let run = scene.run(&format!("{SCENE} --report-without-images"));
    assert_eq!(run.code, Some(2), "{run}");
    let run = scene.run(&format!("{SCENE} --report no/such/folder.html"));
    assert!(run.code != Some(0) && run.stderr.contains("no/such/folder.html"), "{run}");
}

#[test]
fn data_set_report_has_every_scene() {
    let scene = scene();
    scene
        .run("synth export --layout 7scenes --out 7s --map-views 12 --query-views 3 --width 320")
        .succeeded();
    let few = "--max-keypoints 512 --query-keypoints 512 --schemes dcl --jobs 1";
    scene
        .run(&format!(
            "eval dataset 7scenes --root 7s --poses depth {few} --report 7s.html --report-queries 2"
        ))
        .succeeded();
    let text = page(scene, "7s.html");
    assert_eq!(text.matches("<details class=\"fold\" id=\"query-").count(), 2);
    assert!(text.contains("frame-0000") && text.contains("5 cm, 5°"), "7Scenes uses metres");
}

#[test]
fn localize_report_embeds_images_only_if_given() {
    let scene = scene();
    for query in 0..3 {
        scene.seal(&format!("query-{query}.png"), "dcl", &format!("query-{query}.vquery"));
    }
    let queries = "localize --map place.vmap query-0.vquery query-1.vquery query-2.vquery";
    scene.run(&format!("{queries} --report plain.html")).succeeded();
    let text = page(scene, "plain.html");
    assert!(text.contains("contains no images") && !text.contains("data:image"));
    assert_eq!(text.matches("class=\"line inlier\" d=\"M").count(), 3 + 1);
    assert!(text.contains("3 sealed queries localized") && text.contains("± "));
    assert!(text.contains("map units") && text.contains("veiloc localize --map place.vmap"), "its command");
    scene
        .run(&format!("{queries} --report images.html --report-images images --report-queries 2"))
        .succeeded();
    assert_eq!(page(scene, "images.html").matches("data:image/jpeg").count(), 2);

    // A session has one pose and no report.
    let run = scene.run("localize --map place.vmap --rig rig.json --report rig.html");
    assert_eq!(run.code, Some(2), "{run}");
}
