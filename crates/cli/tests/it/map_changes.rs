//! Maps built from the usable images, changed by several programs at once, and without removed images.

use super::common;

use std::fs;

use common::{MAP_VIEWS, TestScene, keys, scene};
use serde_json::Value;
use veiloc_geometry::CameraFromWorld;
use veiloc_map::MapFile;

/// A copy of the map in a separate folder, to be changed.
fn copy(scene: &TestScene, folder: &str) -> String {
    let path = format!("{folder}/place.vmap");
    scene.write(&path, scene.read("place.vmap"));
    path
}

fn info(scene: &TestScene, map: &str) -> Value {
    scene.run(&format!("map info {map} --images --json")).succeeded().json()
}

fn names(info: &Value) -> Vec<&str> {
    info["image_list"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|i| i["name"].as_str().expect("a name"))
        .collect()
}

#[test]
fn concurrent_changes_are_serialized() {
    let scene = scene();
    let map = copy(scene, "at-once");
    let leaving = ["map-01.png", "map-03.png", "map-05.png", "map-07.png"];
    let children: Vec<_> = leaving
        .iter()
        .map(|name| scene.command(&format!("map remove {map} {name}")).spawn().expect("the binary runs"))
        .collect();
    for child in children {
        let output = child.wait_with_output().expect("it ends");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let info = info(scene, &map);
    let left = names(&info);
    assert_eq!(left.len(), MAP_VIEWS - leaving.len());
    assert!(leaving.iter().all(|name| !left.contains(name)), "{left:?}");
    let files: Vec<_> = fs::read_dir(scene.path("at-once")).expect("folder").collect();
    assert_eq!(files.len(), 1, "nothing is left lying about: {files:?}");
}

#[test]
fn remove_reports_vocabulary_traces_and_retrain_clears_them() {
    let scene = scene();
    let before = info(scene, "place.vmap");
    let kept = copy(scene, "kept");
    let run = scene.run(&format!("map remove {kept} map-02.png")).succeeded();
    assert!(run.stderr.contains("words of the vocabulary") && run.stderr.contains("--retrain"), "{run}");
    assert_eq!(
        info(scene, &kept)["profile"],
        before["profile"],
        "queries sealed for the map are still valid"
    );

    let forgot = copy(scene, "forgot");
    let run = scene.run(&format!("map remove {forgot} map-02.png --retrain")).succeeded();
    assert!(run.stderr.contains("new profile") && run.stderr.contains("fetch"), "{run}");
    let after = info(scene, &forgot);
    assert_ne!(after["profile"], before["profile"]);
    assert_eq!(after["images"], MAP_VIEWS - 1);
    assert_eq!(after["points"], info(scene, &kept)["points"]);

    let run = scene.run(&format!("map remove {kept} map-98.png map-99.png"));
    assert!(run.code == Some(1) && run.stderr.contains("map-98.png, map-99.png are not in the map"), "{run}");
}

/// A second session whose files have the same names.
#[test]
fn prefix_distinguishes_images_of_equal_names() {
    let scene = scene();
    let map = copy(scene, "prefixed");
    scene.write("two-again.txt", "map-00.png\nmap-01.png\n");
    let add =
        format!("map add {map} --posed posed --images images --list two-again.txt --no-self-test --prefix");
    scene.run(&format!("{add} session-2/")).succeeded();
    let listed = info(scene, &map);
    let names = names(&listed);
    assert_eq!(names.len(), MAP_VIEWS + 2);
    assert!(names.contains(&"session-2/map-01.png") && names.contains(&"map-01.png"), "{names:?}");
    let run = scene.run(&format!("{add} session-2/"));
    assert!(run.code == Some(1) && run.stderr.contains("already in the map"), "{run}");
}

#[test]
fn images_are_listed() {
    let scene = scene();
    let document = info(scene, "place.vmap");
    assert_eq!(names(&document).len(), MAP_VIEWS);
    let image = &document["image_list"][0];
    assert_eq!(keys(image), ["camera", "keypoints", "name", "observations"]);
    assert!(image["observations"].as_u64() > Some(10), "{image}");
    assert_eq!(document["warnings"].as_array().map(Vec::len), Some(0));
    let run = scene.run("map info place.vmap --images").succeeded();
    assert!(names(&document).iter().all(|name| run.stdout.contains(name)), "{run}");
    let run = scene.run("map info place.vmap").succeeded();
    assert!(!run.stdout.contains("map-00.png"), "{run}");
}

#[test]
fn bad_images_are_named_or_skipped() {
    let scene = scene();
    let png = scene.read("images/map-05.png");
    for name in ["map-00.png", "map-01.png", "map-02.png", "map-03.png"] {
        scene.write(&format!("some/{name}"), scene.read(&format!("images/{name}")));
    }
    scene.write("some/map-05.png", &png[..png.len() / 2]);
    let build =
        "map build --posed posed --images some --list map.txt --max-keypoints 512 -o some.vmap --json";
    let run = scene.run(build);
    assert_eq!(run.code, Some(1), "{run}");
    assert!(run.stderr.contains("5 of 10 images cannot be used"), "{run}");
    for missing in ["map-04.png", "map-06.png", "map-07.png", "map-08.png", "map-09.png", "--skip-bad"] {
        assert!(run.stderr.contains(missing), "{missing}: {run}");
    }
    assert!(!scene.path("some.vmap").exists());

    let run = scene.run(&format!("{build} --skip-bad")).succeeded();
    let document = run.json();
    assert_eq!(document["images"], 4);
    let skipped = document["skipped"].as_array().expect("a list");
    assert_eq!(skipped.len(), 6);
    assert!(skipped.iter().any(|s| s["name"] == "map-05.png"), "found as it was read: {run}");
    assert!(run.stderr.contains("6 images were left out") && run.stderr.contains("map-05.png"), "{run}");
}

/// Cameras and poses suffice; a focal length twice the correct one gives a warning.
#[test]
fn poses_without_points_suffice_and_wrong_focal_length_is_diagnosed() {
    let scene = scene();
    let cameras = String::from_utf8(scene.read("posed/cameras.txt")).expect("text");
    scene.write("bare/cameras.txt", &cameras);
    scene.write("bare/images.txt", scene.read("posed/images.txt"));
    let build = |posed: &str| {
        format!(
            "map build --posed {posed} --images images --list map.txt --max-keypoints 512 --query-keypoints 512 \
             -o {posed}.vmap --json"
        )
    };
    scene.run(&build("bare")).succeeded();
    assert!(scene.read("bare.vmap") == scene.read("place.vmap"), "without points the map differs");

    let first = cameras.lines().find(|l| !l.starts_with('#')).expect("a camera");
    let mut fields: Vec<&str> = first.split(' ').collect();
    fields[4] = "660";
    scene.write("long/cameras.txt", fields.join(" "));
    scene.write("long/images.txt", scene.read("posed/images.txt"));
    is_refused(scene, &build("long"), "long", "about 2.00 times the correct one", "focal-length");
}

/// With camera-to-world poses the existing map stays, and the error names the cause.
#[test]
fn inverted_poses_are_diagnosed_and_old_map_stays() {
    let scene = scene();
    let inverted = (1..).zip(&scene.poses).map(|(id, (name, pose))| {
        let pose = pose.inverse();
        let ([w, x, y, z], t) = (pose.quaternion(), pose.translation());
        format!("{id} {w} {x} {y} {z} {} {} {} 1 {name}\n\n", t.x, t.y, t.z)
    });
    let numbered = inverted.collect::<Vec<_>>().concat();
    scene.write("turned/cameras.txt", scene.read("posed/cameras.txt"));
    scene.write("turned/images.txt", numbered);
    scene.write("turned.vmap", b"a good map");
    let build =
        "map build --posed turned --images images --list map.txt --max-keypoints 512 -o turned.vmap --json";
    let run = scene.run(build);
    assert_eq!(run.code, Some(1), "{run}");
    assert!(run.stderr.contains("poses seem to be camera-to-world"), "{run}");
    assert_eq!(scene.read("turned.vmap"), b"a good map");
}

/// A map in which nothing can be localized is refused by every command that writes a map, not only by the one that
/// made it.
#[test]
fn every_command_refuses_a_broken_map() {
    let scene = scene();
    let mut model = MapFile::open(&scene.path("place.vmap")).expect("a map").to_model();
    for image in &mut model.images {
        let pose = image.cam_from_world.inverse();
        image.cam_from_world = CameraFromWorld::new(*pose.rotation(), *pose.translation());
    }
    veiloc_map::write(&model, &scene.path("broken.vmap")).expect("written");
    scene.write("one.txt", "map-00.png\n");
    let broken = scene.read("broken.vmap");
    for command in [
        "map remove broken.vmap map-00.png",
        "map align broken.vmap --level --down y",
        "map add broken.vmap --posed posed --images images --list one.txt --prefix again/ --no-coordinate-frame-check",
        "map compress broken.vmap --ratio 2 -o broken.vmap",
    ] {
        let run = scene.run(command);
        assert_eq!(run.code, Some(1), "{command}: {run}");
        assert!(run.stderr.contains("nothing can be localized in this map"), "{command}: {run}");
        assert!(scene.read("broken.vmap") == broken, "{command}");
    }
}

/// An unusable map is refused with the cause, and written with --keep-broken.
fn is_refused(scene: &TestScene, build: &str, map: &str, expected: &str, name: &str) {
    let run = scene.run(build);
    assert_eq!(run.code, Some(1), "{run}");
    assert!(run.stderr.contains(expected), "{expected}: {run}");
    assert!(!scene.path(format!("{map}.vmap")).exists());
    let quiet = scene.run(&format!("--quiet {build}"));
    assert!(
        quiet.code == Some(1) && quiet.stderr.contains(expected),
        "an error prints its warnings: {quiet}"
    );
    let run = scene.run(&format!("{build} --keep-broken"));
    if run.code == Some(0) {
        let document = run.json();
        let warnings = document["warnings"].as_array().expect("a list");
        assert!(warnings.iter().any(|w| w["name"] == name), "{name}: {run}");
    } else {
        assert!(run.stderr.contains("no point could be triangulated"), "{run}");
    }
}

/// Two images cannot test each other: this gives a warning, and the map is written.
#[test]
fn map_without_self_test_warns() {
    let scene = scene();
    scene.write("two.txt", "map-00.png\nmap-01.png\n");
    let build =
        "map build --posed posed --images images --list two.txt --max-keypoints 512 -o two.vmap --json";
    let document = scene.run(build).succeeded().json();
    assert_eq!(document["self_test"]["images"], 2);
    let names: Vec<&str> =
        document["warnings"].as_array().expect("a list").iter().filter_map(|w| w["name"].as_str()).collect();
    assert!(names.contains(&"self-test"), "{names:?}");

    let run = scene.run(&format!("{build} --no-self-test")).succeeded();
    assert!(run.json()["self_test"].is_null(), "{run}");
    let text = scene.run("map info two.vmap").succeeded().stdout;
    assert!(text.contains("self-test   none"), "{text}");
}

/// The scene of the tests is sound, and its map has a good self-test; a change is tested again.
#[test]
fn self_test_localizes_own_images() {
    let scene = scene();
    let document = info(scene, "place.vmap");
    let test = &document["self_test"];
    assert_eq!(test["images"], MAP_VIEWS);
    let schemes = test["schemes"].as_array().expect("a list");
    assert_eq!(schemes.len(), 4);
    for scheme in schemes {
        assert!(scheme["relative_recall"]["0.05/5"].as_f64() > Some(0.6), "{scheme}");
        assert!(scheme["calibration"]["factor"].as_f64() > Some(0.0), "{scheme}");
    }
    let text = scene.run("map info place.vmap").succeeded().stdout;
    assert!(text.contains("self-test   10 images") && text.contains("dcl"), "{text}");
    // Numbers are below the end of their column's name.
    let table: Vec<&str> = text
        .lines()
        .skip_while(|line| !line.contains("within 1 %"))
        .take_while(|line| !line.contains("Within"))
        .collect();
    let end =
        |line: &str, word: &str| line.find(word).map(|at| line[..at].chars().count() + word.chars().count());
    assert_eq!(table.len(), 6, "head, rule, four schemes: {text}");
    for line in &table[2..] {
        assert_eq!(end(line, " px"), end(table[0], "noise"), "{text}");
        assert_eq!(line.chars().count(), table[0].chars().count(), "{text}");
    }

    let less = copy(scene, "less");
    scene.run(&format!("map remove {less} map-04.png")).succeeded();
    assert_eq!(info(scene, &less)["self_test"]["images"], MAP_VIEWS - 1);
    scene.run(&format!("map remove {less} map-05.png --no-self-test")).succeeded();
    assert!(info(scene, &less)["self_test"].is_null(), "a changed map must not keep the old self-test");
}
