//! Features and pairs in hloc's files: features of other programs are mapped, sealed and localized here.

use super::common;

use common::{CAMERA, EXTRACTION, POSITION_TOLERANCE, TestScene, scene};
use veiloc_geometry::CameraFromWorld;
use veiloc_mapping::importers::hloc::{FeaturesFile, read_pairs};

/// Features of all images in a file.
fn extracted() -> &'static TestScene {
    static READY: std::sync::Once = std::sync::Once::new();
    let scene = scene();
    READY.call_once(|| {
        let run =
            scene.run("features images --features sift --max-keypoints 512 --out-hloc feats.h5").succeeded();
        assert!(run.stderr.contains("13 images"), "{run}");
        let camera = CAMERA.replace(',', " ");
        scene
            .write("hloc.txt", format!("query-0.png {camera}\nquery-1.png {camera}\nquery-2.png {camera}\n"));
    });
    scene
}

fn build(more: &str) -> String {
    format!("map build --posed posed --images images --list map.txt {} {more}", EXTRACTION.join(" "))
}

/// Largest error of the camera centre over the lines of a result file.
fn worst(scene: &TestScene, file: &str) -> f64 {
    let text = String::from_utf8(scene.read(file)).expect("text");
    assert_eq!(text.lines().count(), 3, "{text}");
    let error = |line: &str| {
        let (name, numbers) = line.split_once(' ').expect("a name and numbers");
        let n: Vec<f64> = numbers.split(' ').map(|n| n.parse().expect("a number")).collect();
        let pose =
            CameraFromWorld::from_quaternion([n[0], n[1], n[2], n[3]], [n[4], n[5], n[6]]).expect("a pose");
        scene.position_error(name, &pose)
    };
    text.lines().map(error).fold(0.0, f64::max)
}

#[test]
fn stored_features_give_the_same_map_and_queries() {
    let scene = extracted();
    let file = FeaturesFile::open(&scene.path("feats.h5")).expect("a file");
    assert_eq!((file.names().expect("names").len(), file.dim().expect("descriptors")), (13, Some(128)));
    let of_file =
        scene.run(&build("--features sift --features-file feats.h5 -o file.vmap --json")).succeeded();
    let own = scene.run(&build("--features sift -o own.vmap --json")).succeeded();
    let points = |run: &common::Run| run.json()["points"].as_u64().expect("a number") as f64;
    let (of_file, own) = (points(&of_file), points(&own));
    assert!((of_file / own - 1.0).abs() < 0.05, "{of_file} points and {own}");
    for scheme in ["points", "dcl"] {
        let localize = format!(
            "localize --map file.vmap --queries hloc.txt --images images --features-file feats.h5 --scheme {scheme} \
             --out-hloc {scheme}.txt"
        );
        scene.run(&localize).succeeded();
        let error = worst(scene, &format!("{scheme}.txt"));
        assert!(error < POSITION_TOLERANCE, "{scheme}: {error}");
    }
    // Features of the same name are one kind, regardless of the program that extracted them.
    scene.run("map profile file.vmap -o file.vprofile").succeeded();
    scene
        .run(&format!("seal images/query-0.png --camera {CAMERA} --profile file.vprofile -o mixed.vquery"))
        .succeeded();
    scene.run("localize --map file.vmap mixed.vquery").succeeded();
}

#[test]
fn features_of_another_name_are_another_kind() {
    let scene = extracted();
    scene.run(&build("--features theirs --features-file feats.h5 --no-self-test -o theirs.vmap")).succeeded();
    scene.run("map profile theirs.vmap -o theirs.vprofile").succeeded();
    let seal = |more: &str| {
        scene.run(&format!(
            "seal images/query-0.png --camera {CAMERA} --profile theirs.vprofile -o theirs.vquery {more}"
        ))
    };
    let without = seal("");
    assert!(without.code == Some(1) && without.stderr.contains("theirs"), "{without}");
    seal("--features-file feats.h5").succeeded();
    scene.run("localize --map theirs.vmap theirs.vquery").succeeded();
    let other = seal("--features sift --features-file feats.h5");
    assert!(other.code == Some(1) && other.stderr.contains("do not match"), "{other}");
    // They were extracted from the whole image.
    let (white, black) = (image::Luma([255_u8]), image::Luma([0_u8]));
    let mask = image::GrayImage::from_fn(400, 300, |x, _| if x < 100 { black } else { white });
    mask.save(scene.path("mask.png")).expect("written");
    let masked = seal("--features-file feats.h5 --mask mask.png");
    assert!(masked.code == Some(1) && masked.stderr.contains("whole image"), "{masked}");
}

#[test]
fn missing_entries_are_reported() {
    let scene = extracted();
    scene.write("short.txt", "map-00.png\nmap-01.png\n");
    let short = "features images --list short.txt --features sift --max-keypoints 300 --out-hloc short.h5";
    scene.run(short).succeeded();
    scene.write("no.h5", "no HDF5 file");
    for (more, word) in [
        ("--features-file feats.h5 -o no.vmap", "--features"),
        ("--features sift --features-file short.h5 -o no.vmap", "map-02.png"),
        ("--features sift --features-file no.h5 -o no.vmap", "HDF5"),
        ("--features sift --features-file none.h5 -o no.vmap", "none.h5"),
        ("--features sift --pairs feats.h5 -o no.vmap", "not text"),
    ] {
        let run = scene.run(&build(more));
        assert!(run.code == Some(1) && run.stderr.contains(word), "{more}: {run}");
        assert!(!scene.path("no.vmap").exists());
    }
}

#[test]
fn exported_pairs_reproduce_the_map() {
    let scene = extracted();
    let few = "--no-self-test --features sift --features-file feats.h5";
    let first =
        scene.run(&build(&format!("{few} --out-pairs pairs.txt -o first.vmap --json"))).succeeded().json();
    let pairs = read_pairs(&scene.path("pairs.txt")).expect("pairs");
    assert!(pairs.len() >= 9 && pairs.iter().all(|(a, b)| a.starts_with("map-") && a < b), "{pairs:?}");
    let again =
        scene.run(&build(&format!("{few} --pairs pairs.txt -o again.vmap --json"))).succeeded().json();
    assert_eq!(first["points"], again["points"]);
    scene.write("one.txt", "map-00.png map-01.png\nmap-00.png query-0.png\n");
    let one = scene.run(&build(&format!("{few} --keep-broken --pairs one.txt -o one.vmap --json")));
    assert!(one.code != Some(2), "{one}");
    scene.write("foreign.txt", "a.png b.png\n");
    let none = scene.run(&build(&format!("{few} --pairs foreign.txt -o none.vmap")));
    assert!(none.code == Some(1) && none.stderr.contains("none of the 1 given pairs"), "{none}");
}
