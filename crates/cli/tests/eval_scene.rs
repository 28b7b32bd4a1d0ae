//! `veiloc eval scene` with queries of another place, which must not be localized.

mod common;

use common::{CAMERA, place};
use veiloc_geometry::Intrinsics;
use veiloc_map::colmap::{ColmapImage, ColmapModel, write_text};
use veiloc_synth::{PathOptions, Place, RenderOptions};

const NEGATIVES: usize = 2;

const SCENE: &str = "eval scene --posed posed --images images --map-list map.txt --query-list queries.txt \
                     --max-keypoints 1024 --query-keypoints 1024 --schemes points,dcl";

/// Views of another room, beside the place of the tests.
fn render_negatives() {
    let folder = &place().folder;
    let camera: Intrinsics = CAMERA.parse().expect("a camera");
    let other = Place::generate(12);
    let path = other.camera_path(&PathOptions::with_counts(4, NEGATIVES));
    std::fs::create_dir_all(folder.join("other/images")).expect("folder");
    let mut images = Vec::new();
    for (id, pose) in (1_u32..).zip(&path.queries) {
        let name = format!("negative-{id}.png");
        let view = other.render(pose, &camera, &RenderOptions::with_seed(u64::from(id)));
        view.rgb().save(folder.join("other/images").join(&name)).expect("written");
        images.push(ColmapImage { id, name, camera_id: 1, cam_from_world: *pose, points2d: Vec::new() });
    }
    let names: Vec<String> = images.iter().map(|image| image.name.clone()).collect();
    place().write("other/list.txt", names.join("\n"));
    let model = ColmapModel::new(vec![(1, camera)], images, Vec::new()).expect("a model");
    write_text(&model, &folder.join("other/posed")).expect("written");
}

#[test]
fn negatives_are_counted_and_not_trusted() {
    let place = place();
    render_negatives();
    let negatives =
        "--negatives-posed other/posed --negatives-images other/images --negatives-list other/list.txt";
    let run = place.run(&format!("{SCENE} {negatives} --json scene.json")).succeeded();
    assert!(run.stdout.contains("negatives localized") && run.stdout.contains("negatives trusted"), "{run}");
    let document: serde_json::Value = serde_json::from_slice(&place.read("scene.json")).expect("a document");
    for row in document["schemes"].as_array().expect("an array") {
        assert_eq!(row["negatives"]["queries"], NEGATIVES, "{row}");
        assert_eq!(row["negatives"]["trusted"], 0, "{row}");
        assert!(row["trusted"].as_u64().is_some_and(|n| n >= 2), "own queries are trusted: {row}");
        assert_eq!(row["prior"], true, "{row}");
    }
    let each = document["negatives"].as_array().expect("an array");
    assert_eq!(each.len(), 2 * NEGATIVES);
    assert!(each.iter().all(|s| s["localized"].is_boolean() && s["trusted"] == false), "{each:?}");

    let cases: &[(&str, i32, &[&str])] = &[
        ("--negatives-posed other/posed", 2, &["--negatives-images", "--negatives-list"]),
        ("--negatives-list other/list.txt", 2, &["--negatives-posed"]),
        (
            "--negatives-posed posed --negatives-images images --negatives-list queries.txt",
            1,
            &["negatives", "another place"],
        ),
        (
            "--negatives-posed other/posed --negatives-images other/images --negatives-list map.txt",
            1,
            &["map-00.png", "no pose"],
        ),
    ];
    for (arguments, code, says) in cases {
        let run = place.run(&format!("{SCENE} {arguments}"));
        assert_eq!(run.code, Some(*code), "{run}");
        assert!(run.stdout.is_empty() && says.iter().all(|word| run.stderr.contains(word)), "{run}");
    }
}

#[test]
fn problems_of_a_place_are_what_eval_pose_reads() {
    let place = place();
    let make = "eval problems --posed posed --images images --map-list map.txt --query-list queries.txt \
                --max-keypoints 1024";
    for file in ["made.jsonl", "made.jsonl.gz"] {
        place.run(&format!("{make} -o {file}")).succeeded();
        let run = place.run(&format!("eval pose {file} --schemes points,dcl --json made.json")).succeeded();
        let document: serde_json::Value =
            serde_json::from_slice(&place.read("made.json")).expect("a document");
        for row in document["schemes"].as_array().expect("an array") {
            assert_eq!(row["localized"], row["queries"], "{run}");
            assert_eq!(row["prior"], true, "ratio, votes and track length are there: {run}");
        }
        let of = |options: &str| {
            place.run(&format!("eval pose {file} --schemes dcl --json fixed.json {options}")).succeeded();
            let document: serde_json::Value =
                serde_json::from_slice(&place.read("fixed.json")).expect("a document");
            document["queries"][0]["translation_error"].as_f64().expect("a number")
        };
        assert_ne!(of("--noise 3 --fixed-noise"), of("--noise 3"));
    }
    assert_eq!(place.read("made.jsonl.gz")[..2], [0x1f, 0x8b]);
    let refused = place.run(&format!("{make} -o no/such/folder/made.jsonl"));
    assert_eq!(refused.code, Some(1), "{refused}");
}
