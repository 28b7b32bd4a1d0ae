//! A killed map build leaves the old map unchanged, and leaves nothing that disturbs the next build.

use super::common;

use std::fs;
use std::io::{BufRead as _, BufReader};

use common::{MAP_VIEWS, Place, place};
use veiloc_map::MapLock;

const BUILD: &str = "map build --posed posed --images images --list map.txt --max-keypoints 1024 --query-keypoints 1024 \
                     -o live/place.vmap";

/// Names in the folder of the map, sorted.
fn names(place: &Place) -> Vec<String> {
    let entries = fs::read_dir(place.path("live")).expect("the folder of the map");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// What must hold at any time: the old map is complete, and no other file looks like a map.
fn old_map_is_untouched(place: &Place, old: &[u8], when: &str) {
    assert!(place.read("live/place.vmap") == old, "{when}: the old map changed");
    let info = place.run("map info live/place.vmap --json").succeeded().json();
    assert_eq!(info["images"], 3, "{when}");
    for name in names(place) {
        let is_map = name == "place.vmap";
        let is_rest = [".partial", ".lock"].iter().any(|end| name.starts_with('.') && name.ends_with(end));
        assert!(is_map || is_rest, "{when}: {name} would be taken for a map");
    }
}

/// Starts the build, and kills it when its log has a line that begins with `stage`.
fn killed_in(place: &Place, stage: &str) {
    let mut child = place.command(BUILD).spawn().expect("the binary runs");
    let mut lines = BufReader::new(child.stderr.take().expect("piped")).lines().map_while(Result::ok);
    assert!(lines.any(|line| line.starts_with(stage)), "it came to {stage}");
    assert!(child.try_wait().expect("a child").is_none(), "it cannot end without the lock");
    child.kill().expect("killed");
    child.wait().expect("ended");
}

/// Starts the build, and kills it when another file appears beside the map.
fn killed_while_writing(place: &Place) {
    let mut child = place.command(BUILD).spawn().expect("the binary runs");
    let is_writing = || names(place).iter().any(|name| name.ends_with(".partial"));
    while !is_writing() && child.try_wait().expect("a child").is_none() {
        std::thread::yield_now();
    }
    child.kill().expect("killed");
    child.wait().expect("ended");
}

#[test]
fn a_killed_build_leaves_the_old_map() {
    let place = place();
    // The old map differs from the one being built.
    fs::create_dir_all(place.path("live")).expect("folder");
    place.write("three.txt", "map-00.png\nmap-01.png\nmap-02.png\n");
    let small = BUILD.replace("map.txt", "three.txt");
    place.run(&small).succeeded();
    let old = place.read("live/place.vmap");
    place.run(&BUILD.replace("live/", "")).succeeded();

    // In each stage in turn. The lock that is held here prevents every build from replacing the map.
    let lock = MapLock::acquire(&place.path("live/place.vmap")).expect("nobody else holds it");
    for stage in ["Extracting features", "Matching pairs", "Triangulating points", "Testing the map"] {
        killed_in(place, stage);
        old_map_is_untouched(place, &old, stage);
    }
    drop(lock);

    // While the file is written.
    let mut caught = 0;
    for _ in 0..3 {
        killed_while_writing(place);
        if place.read("live/place.vmap") == old {
            caught += 1;
            old_map_is_untouched(place, &old, "killed while writing");
        } else {
            // The kill came after the rename: then the new map is complete.
            place.run("map info live/place.vmap").succeeded();
            place.write("live/place.vmap", &old);
        }
    }
    eprintln!("{caught} of 3 kills came between the first byte and the rename");

    // Partial files, also of other writers, do not disturb the next build, which removes them.
    place.write("live/.place.vmap.4194304999-0.partial", &old[..old.len() / 2]);
    let run = place.run(&format!("{BUILD} --json")).succeeded();
    assert_eq!(run.json()["images"], MAP_VIEWS);
    assert_eq!(names(place), ["place.vmap"], "what killed builds left is cleared away");
    assert!(
        place.read("live/place.vmap") == place.read("place.vmap"),
        "the build is not what it would have been"
    );
}

/// The same for a build that fails by itself.
#[test]
fn a_refused_build_leaves_the_old_map() {
    let place = place();
    fs::create_dir_all(place.path("own")).expect("folder");
    place.write("own/place.vmap", place.read("place.vmap"));
    place.write("own/list.txt", "map-00.png\nmap-01.png\nmissing.png\n");
    let run = place.run("map build --posed posed --images images --list own/list.txt -o own/place.vmap");
    assert_eq!(run.code, Some(1), "{run}");
    assert!(place.read("own/place.vmap") == place.read("place.vmap"));
    // The image exists when the build starts, and is found to be damaged in the middle of it.
    let posed = String::from_utf8(place.read("posed/images.txt")).expect("text");
    for file in ["cameras.txt", "points3D.txt"] {
        place.write(&format!("own/posed/{file}"), place.read(&format!("posed/{file}")));
    }
    place.write("own/posed/images.txt", posed.replace("map-05.png", "cut.png"));
    let png = place.read("images/map-05.png");
    place.write("images/cut.png", &png[..png.len() / 2]);
    place.write("own/cut.txt", "map-00.png\nmap-01.png\ncut.png\n");
    let run = place.run("map build --posed own/posed --images images --list own/cut.txt -o own/place.vmap");
    assert!(run.code == Some(1) && run.stderr.contains("cut.png"), "{run}");
    assert!(place.read("own/place.vmap") == place.read("place.vmap"));
}
