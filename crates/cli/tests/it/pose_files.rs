//! `veiloc localize --queries LIST --images DIR`: images as input, pose files for other programs as output.

use super::common;

use common::{CAMERA, POSITION_TOLERANCE, scene};
use veiloc_geometry::CameraFromWorld;
use veiloc_map::colmap::read_posed;

const OUT: &str = "--out-hloc poses/hloc.txt --out-colmap poses/model --out-tum poses/tum.txt";

fn text(file: &str) -> String {
    String::from_utf8(scene().read(file)).expect("text")
}

/// Numbers after the first word of each line.
fn rows(file: &str) -> Vec<(String, Vec<f64>)> {
    let row = |line: &str| {
        let mut words = line.split(' ');
        let name = words.next().expect("a name").to_owned();
        (name, words.map(|word| word.parse().expect("a number")).collect())
    };
    text(file).lines().map(row).collect()
}

fn pose(n: &[f64]) -> CameraFromWorld {
    CameraFromWorld::from_quaternion([n[0], n[1], n[2], n[3]], [n[4], n[5], n[6]]).expect("a rotation")
}

#[test]
fn pose_files_match_json_poses() {
    let scene = scene();
    scene.write("poses/.keep", "");
    scene.write("nested/day/query-0.png", scene.read("images/query-0.png"));
    scene.write("nested/query-1.png", scene.read("images/query-1.png"));
    let camera = CAMERA.replace(',', " ");
    scene.write(
        "nested.txt",
        format!("# queries\nday/query-0.png {camera}\nno-such.png {camera}\nquery-1.png {camera}\n"),
    );
    let command = format!(
        "localize --map place.vmap --queries nested.txt --images nested {OUT} --scheme dcl --skip-bad"
    );
    let run = scene.run(&format!("{command} --json")).succeeded();
    let document = run.json();
    let queries = document["queries"].as_array().expect("an array");
    let files: Vec<&str> = queries.iter().map(|q| q["file"].as_str().expect("a name")).collect();
    assert_eq!(files, ["day/query-0.png", "no-such.png", "query-1.png"]);
    assert_eq!((document["trusted"].as_u64(), document["failed"].as_u64()), (Some(2), Some(1)));

    let hloc = rows("poses/hloc.txt");
    let names: Vec<&str> = hloc.iter().map(|row| row.0.as_str()).collect();
    assert_eq!(names, ["day/query-0.png", "query-1.png"]);
    let truth = [scene.pose_of("query-0.png"), scene.pose_of("query-1.png")];
    for ((_, numbers), truth) in hloc.iter().zip(&truth) {
        let error = pose(numbers).translation_error(truth);
        assert!(error < POSITION_TOLERANCE, "{error}");
    }

    // The second of the list has no pose, and keeps its index.
    let tum = rows("poses/tum.txt");
    assert_eq!(tum.iter().map(|row| row.0.as_str()).collect::<Vec<_>>(), ["0", "2"]);
    for ((_, n), (_, h)) in tum.iter().zip(&hloc) {
        let center = pose(h).center().coords;
        assert!((center.x - n[0]).abs() + (center.y - n[1]).abs() + (center.z - n[2]).abs() < 1e-12);
        let back = CameraFromWorld::from_quaternion([n[6], n[3], n[4], n[5]], [0.0; 3]).expect("a rotation");
        let apart = back.inverse().rotation().matrix() - pose(h).rotation().matrix();
        assert!(apart.norm() < 1e-9, "{apart}");
    }

    let model = read_posed(&scene.path("poses/model")).expect("a model");
    assert_eq!(model.names(), names);
    for (image, (_, numbers)) in model.images().iter().zip(&hloc) {
        assert_eq!(image.camera, CAMERA.parse().expect("a camera"));
        assert!(image.cam_from_world.translation_error(&pose(numbers)) < 1e-12);
    }
    scene.run(&format!("{command} --text").replace("poses/model", "poses/text")).succeeded();
    assert!(text("poses/text/images.txt").contains("day/query-0.png"));
}

#[test]
fn pose_files_name_sealed_queries_by_file() {
    let scene = scene();
    scene.write("poses/.keep", "");
    scene.write("sealed/.keep", "");
    scene.seal("query-0.png", "dcl", "sealed/query-0.vquery");
    scene.run("localize --map place.vmap sealed --out-hloc poses/sealed.txt").succeeded();
    assert_eq!(rows("poses/sealed.txt")[0].0, "query-0");
    let model = scene.run("localize --map place.vmap sealed --out-colmap poses/none");
    assert!(model.code == Some(2) && model.stderr.contains("--queries"), "{model}");
}

#[test]
fn contradictory_arguments_are_refused_before_work() {
    let scene = scene();
    let camera = CAMERA.replace(',', " ");
    scene.write("list.txt", format!("query-0.png {camera}\n"));
    scene.write("spaced.txt", format!("a b.png {camera}\n"));
    scene.write("away.txt", format!("../query-0.png {camera}\n"));
    let usage = [
        ("localize --map place.vmap --queries list.txt", "--images"),
        ("localize --map place.vmap good.vquery --scheme points", "--queries"),
        ("localize --map place.vmap good.vquery --max-keypoints 512", "--queries"),
        ("localize --map place.vmap --queries list.txt --images images good.vquery", "cannot be used with"),
        ("localize --map place.vmap", "required"),
    ];
    for (command, word) in usage {
        let run = scene.run(command);
        assert!(run.code == Some(2) && run.stderr.contains(word), "{command}: {run}");
    }
    let of = |list: &str, more: &str| {
        scene.run(&format!("localize --map place.vmap --queries {list} --images images {more}"))
    };
    for (run, word) in [
        (of("spaced.txt", "--out-hloc a.txt"), "white space"),
        (of("away.txt", ""), "leads out of"),
        (of("list.txt", "--out-tum -"), "stdout"),
        (of("list.txt", "--camera unknown"), "its own camera"),
    ] {
        assert!(run.code == Some(1) && run.stderr.contains(word), "{word}: {run}");
        assert!(!scene.path("a.txt").exists());
    }
}
