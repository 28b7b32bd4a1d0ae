//! A killed map build leaves the old map unchanged, and leaves nothing that disturbs the next build.

use super::common;

use std::fs;
use std::io::{BufRead as _, BufReader};

use common::{MAP_VIEWS, TestScene, scene};
use veiloc_map::MapLock;

const BUILD: &str = "map build --posed posed --images images --list map.txt --max-keypoints 512 --query-keypoints 512 \
                     -o live/place.vmap";

/// Names in the folder of the map, sorted.
fn names(scene: &TestScene) -> Vec<String> {
    let entries = fs::read_dir(scene.path("live")).expect("the folder of the map");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// What must hold at any time: the old map is complete, and no other file looks like a map.
fn old_map_is_untouched(scene: &TestScene, old: &[u8], when: &str) {
    assert!(scene.read("live/place.vmap") == old, "{when}: the old map changed");
    let info = scene.run("map info live/place.vmap --json").succeeded().json();
    assert_eq!(info["images"], 3, "{when}");
    for name in names(scene) {
        let is_map = name == "place.vmap";
        let is_rest = [".partial", ".lock"].iter().any(|end| name.starts_with('.') && name.ends_with(end));
        assert!(is_map || is_rest, "{when}: {name} would be taken for a map");
    }
}

/// Starts the build, and kills it when its log has a line that begins with `stage`.
fn killed_in(scene: &TestScene, stage: &str) {
    let mut child = scene.command(BUILD).spawn().expect("the binary runs");
    let mut lines = BufReader::new(child.stderr.take().expect("piped")).lines().map_while(Result::ok);
    assert!(lines.any(|line| line.starts_with(stage)), "it came to {stage}");
    assert!(child.try_wait().expect("a child").is_none(), "the build cannot end without the lock");
    child.kill().expect("killed");
    child.wait().expect("ended");
}

/// Starts the build, and kills it when another file appears beside the map.
fn killed_while_writing(scene: &TestScene) {
    let mut child = scene.command(BUILD).spawn().expect("the binary runs");
    let is_writing = || names(scene).iter().any(|name| name.ends_with(".partial"));
    while !is_writing() && child.try_wait().expect("a child").is_none() {
        std::thread::yield_now();
    }
    child.kill().expect("killed");
    child.wait().expect("ended");
}

#[test]
fn killed_build_keeps_old_map() {
    let scene = scene();
    // The old map differs from the one being built.
    fs::create_dir_all(scene.path("live")).expect("folder");
    scene.write("three.txt", "map-00.png\nmap-01.png\nmap-02.png\n");
    let small = BUILD.replace("map.txt", "three.txt");
    scene.run(&small).succeeded();
    let old = scene.read("live/place.vmap");
    scene.run(&BUILD.replace("live/", "")).succeeded();

    // In each stage in turn. The lock that is held here prevents every build from replacing the map.
    let lock = MapLock::acquire(&scene.path("live/place.vmap")).expect("no other process holds the lock");
    for stage in ["Extracting features", "Matching pairs", "Triangulating points", "Testing the map"] {
        killed_in(scene, stage);
        old_map_is_untouched(scene, &old, stage);
    }
    drop(lock);

    // While the file is written.
    let mut caught = 0;
    for _ in 0..3 {
        killed_while_writing(scene);
        if scene.read("live/place.vmap") == old {
            caught += 1;
            old_map_is_untouched(scene, &old, "killed while writing");
        } else {
            // The kill came after the rename: then the new map is complete.
            scene.run("map info live/place.vmap").succeeded();
            scene.write("live/place.vmap", &old);
        }
    }
    eprintln!("{caught} of 3 kills came between the first byte and the rename");

    // Partial files, also of other writers, do not disturb the next build, which removes them.
    scene.write("live/.place.vmap.4194304999-0.partial", &old[..old.len() / 2]);
    let run = scene.run(&format!("{BUILD} --json")).succeeded();
    assert_eq!(run.json()["images"], MAP_VIEWS);
    assert_eq!(names(scene), ["place.vmap"], "files of killed builds are removed");
    assert!(
        scene.read("live/place.vmap") == scene.read("place.vmap"),
        "the build differs from an uninterrupted one"
    );
}

/// The same for a build that fails by itself.
#[test]
fn refused_build_keeps_old_map() {
    let scene = scene();
    fs::create_dir_all(scene.path("own")).expect("folder");
    scene.write("own/place.vmap", scene.read("place.vmap"));
    scene.write("own/list.txt", "map-00.png\nmap-01.png\nmissing.png\n");
    let run = scene.run("map build --posed posed --images images --list own/list.txt -o own/place.vmap");
    assert_eq!(run.code, Some(1), "{run}");
    assert!(scene.read("own/place.vmap") == scene.read("place.vmap"));
    // The image exists when the build starts, and is found to be damaged in the middle of it.
    let posed = String::from_utf8(scene.read("posed/images.txt")).expect("text");
    for file in ["cameras.txt", "points3D.txt"] {
        scene.write(&format!("own/posed/{file}"), scene.read(&format!("posed/{file}")));
    }
    scene.write("own/posed/images.txt", posed.replace("map-05.png", "cut.png"));
    let png = scene.read("images/map-05.png");
    scene.write("images/cut.png", &png[..png.len() / 2]);
    scene.write("own/cut.txt", "map-00.png\nmap-01.png\ncut.png\n");
    let run = scene.run("map build --posed own/posed --images images --list own/cut.txt -o own/place.vmap");
    assert!(run.code == Some(1) && run.stderr.contains("cut.png"), "{run}");
    assert!(scene.read("own/place.vmap") == scene.read("place.vmap"));
}
