//! `veiloc localize --queries LIST --images DIR`: images as input, pose files for other programs as output.

use super::common;

use common::{CAMERA, place};
use veiloc_geometry::CameraFromWorld;
use veiloc_map::colmap::read_posed;

const OUT: &str = "--out-hloc poses/hloc.txt --out-colmap poses/model --out-tum poses/tum.txt";

fn text(file: &str) -> String {
    String::from_utf8(place().read(file)).expect("text")
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
fn a_list_of_images_becomes_files_of_the_poses_of_the_answers() {
    let place = place();
    place.write("poses/.keep", "");
    place.write("nested/day/query-0.png", place.read("images/query-0.png"));
    place.write("nested/query-1.png", place.read("images/query-1.png"));
    let camera = CAMERA.replace(',', " ");
    place.write(
        "nested.txt",
        format!("# queries\nday/query-0.png {camera}\nno-such.png {camera}\nquery-1.png {camera}\n"),
    );
    let command = format!(
        "localize --map place.vmap --queries nested.txt --images nested {OUT} --scheme dcl --skip-bad"
    );
    let run = place.run(&format!("{command} --json")).succeeded();
    let document = run.json();
    let queries = document["queries"].as_array().expect("an array");
    let files: Vec<&str> = queries.iter().map(|q| q["file"].as_str().expect("a name")).collect();
    assert_eq!(files, ["day/query-0.png", "no-such.png", "query-1.png"]);
    assert_eq!((document["localized"].as_u64(), document["failed"].as_u64()), (Some(2), Some(1)));

    let hloc = rows("poses/hloc.txt");
    let names: Vec<&str> = hloc.iter().map(|row| row.0.as_str()).collect();
    assert_eq!(names, ["day/query-0.png", "query-1.png"]);
    let truth = [place.pose_of("query-0.png"), place.pose_of("query-1.png")];
    for ((_, numbers), truth) in hloc.iter().zip(&truth) {
        let error = pose(numbers).translation_error(truth);
        assert!(error < 0.05, "{error}");
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

    let model = read_posed(&place.path("poses/model")).expect("a model");
    assert_eq!(model.names(), names);
    for (image, (_, numbers)) in model.images().iter().zip(&hloc) {
        assert_eq!(image.camera, CAMERA.parse().expect("a camera"));
        assert!(image.cam_from_world.translation_error(&pose(numbers)) < 1e-12);
    }
    place.run(&format!("{command} --text").replace("poses/model", "poses/text")).succeeded();
    assert!(text("poses/text/images.txt").contains("day/query-0.png"));
}

#[test]
fn sealed_queries_have_the_names_of_their_files() {
    let place = place();
    place.write("poses/.keep", "");
    place.write("sealed/.keep", "");
    place.seal("query-0.png", "dcl", "sealed/query-0.vquery");
    place.run("localize --map place.vmap sealed --out-hloc poses/sealed.txt").succeeded();
    assert_eq!(rows("poses/sealed.txt")[0].0, "query-0");
    let model = place.run("localize --map place.vmap sealed --out-colmap poses/none");
    assert!(model.code == Some(2) && model.stderr.contains("--queries"), "{model}");
}

#[test]
fn what_does_not_fit_together_is_told_before_the_work() {
    let place = place();
    let camera = CAMERA.replace(',', " ");
    place.write("list.txt", format!("query-0.png {camera}\n"));
    place.write("spaced.txt", format!("a b.png {camera}\n"));
    place.write("away.txt", format!("../query-0.png {camera}\n"));
    let usage = [
        ("localize --map place.vmap --queries list.txt", "--images"),
        ("localize --map place.vmap good.vquery --scheme points", "--queries"),
        ("localize --map place.vmap good.vquery --max-keypoints 512", "--queries"),
        ("localize --map place.vmap --queries list.txt --images images good.vquery", "cannot be used with"),
        ("localize --map place.vmap", "required"),
    ];
    for (command, word) in usage {
        let run = place.run(command);
        assert!(run.code == Some(2) && run.stderr.contains(word), "{command}: {run}");
    }
    let of = |list: &str, more: &str| {
        place.run(&format!("localize --map place.vmap --queries {list} --images images {more}"))
    };
    for (run, word) in [
        (of("spaced.txt", "--out-hloc a.txt"), "white space"),
        (of("away.txt", ""), "leads out of"),
        (of("list.txt", "--out-tum -"), "stdout"),
        (of("list.txt", "--camera unknown"), "its own camera"),
    ] {
        assert!(run.code == Some(1) && run.stderr.contains(word), "{word}: {run}");
        assert!(!place.path("a.txt").exists());
    }
}
