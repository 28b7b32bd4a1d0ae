//! Outputs are checked before any input is read, so that no work is lost.

use super::common;

use common::{CAMERA, folder, scene};

/// Command lines whose inputs do not exist, with `OUT` for an output.
const COMMANDS: [&str; 30] = [
    "map build --posed none --images none -o OUT",
    "map build --posed none --images none -o good --out-pairs OUT",
    "map import --model none --images none -o OUT",
    "map add none.vmap --posed none --images none -o OUT",
    "map remove none.vmap a.jpg -o OUT",
    "map profile none.vmap -o OUT",
    "map compress none.vmap -o OUT",
    "map export none.vmap --ply OUT",
    "localize --map none.vmap none.vquery --out-hloc OUT",
    "localize --map none.vmap none.vquery --out-tum OUT",
    "localize --map none.vmap none.vquery --report OUT",
    "features none.jpg --out-hloc OUT",
    "audit none.jpg --json OUT",
    "attack none.jsonl --json OUT",
    "eval pose none.jsonl --json OUT",
    "eval keypoints none.jpg -o OUT",
    "eval scene --map none.vmap --negatives none --json OUT",
    "eval problems SCENE -o OUT",
    "eval problems SCENE -o good --keypoints OUT",
    "eval scene SCENE --json OUT",
    "eval scene SCENE --report OUT",
    "eval scene SCENE --keep-map OUT",
    "eval inversion none.jpg --network none.toml --contact-sheet OUT",
    "eval inversion none.jpg --network none.toml --report OUT",
    "eval dataset 7scenes --root none --json OUT",
    "eval dataset 7scenes --root none --report OUT",
    "eval dataset 7scenes --root none --attack 1 --attack-json OUT",
    "eval dataset cambridge --root none --json OUT",
    "eval dataset aachen --root none --submission OUT",
    "eval dataset aachen --root none --json OUT",
];

/// The same with `OUT` for a folder, which is created.
const FOLDERS: [&str; 10] = [
    "map split none.vmap -o OUT",
    "map export none.vmap --colmap OUT",
    "map build --posed none --images none -o good --work OUT",
    "localize --map none.vmap --queries none.txt --images none --out-colmap OUT",
    "demo --out OUT",
    "synth city --out OUT",
    "synth export --layout 7scenes --out OUT",
    "eval scene SCENE --work OUT",
    "audit none.jpg -o OUT",
    "seal none.jpg --profile none.vprofile -o OUT",
];

const SCENE: &str = "--posed none --images none --map-list none.txt --query-list none.txt";

#[test]
fn outputs_are_checked_before_inputs() {
    let place = folder();
    place.write("file", "");
    place.write("folder/file", "");
    let mut wrong = Vec::new();
    let mut expect = |line: &str, out: &str, reason: &str| {
        let line = line.replace("SCENE", SCENE).replace("OUT", out);
        let run = place.run(&line);
        let said = run.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
        if run.code != Some(1) || !said.contains(reason) || !said.contains(out) || !run.stdout.is_empty() {
            wrong.push(run.to_string());
        }
    };
    for line in COMMANDS {
        expect(line, "no/such/out", "its folder no/such does not exist");
        expect(line, "folder", "this is a folder, and a file is expected");
    }
    for line in FOLDERS {
        expect(line, "file/out", "file is not a folder");
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n\n"));
    assert!(!place.path("good").exists());
}

/// Images of such names cannot be listed in pairs: the build does not begin.
#[test]
fn names_that_a_list_of_pairs_cannot_hold() {
    let place = folder();
    place.write("posed/cameras.txt", "1 PINHOLE 640 480 500 500 320 240\n");
    place.write("posed/images.txt", "1 1 0 0 0 0 0 0 1 a.jpg\n\n2 1 0 0 0 0 0 0 1 my photo.jpg\n\n");
    place.write("list.txt", "a.jpg\n");
    let build = "map build --posed posed --images . -o a.vmap --out-pairs pairs.txt";
    let run = place.run(build);
    assert!(run.code == Some(1) && run.stderr.contains("my photo.jpg"), "{run}");
    assert!(run.stderr.contains("white space"), "{run}");
    let run = place.run(&format!("{build} --list list.txt"));
    assert!(run.code == Some(1) && !run.stderr.contains("white space"), "only the listed names count: {run}");
}

/// Two images of one name, or of the name of a folder, cannot be in one feature file: nothing is extracted.
#[test]
fn names_that_a_feature_file_cannot_hold() {
    let place = folder();
    place.write("a/1.jpg/2.jpg", "no image");
    place.write("b/1.jpg", "no image");
    let run = place.run("features a b --out-hloc f.h5");
    assert!(run.code == Some(1) && run.stderr.contains("folder"), "{run}");
}

#[cfg(unix)]
#[test]
fn links_stay_and_their_targets_are_replaced() {
    let scene = scene();
    scene.write("maps/1.vprofile", "old");
    std::os::unix::fs::symlink("maps/1.vprofile", scene.path("current.vprofile")).expect("linked");
    std::os::unix::fs::symlink("place.vmap", scene.path("current.vmap")).expect("linked");
    scene.run("map profile place.vmap -o current.vprofile").succeeded();
    assert!(scene.read("maps/1.vprofile") == scene.read("place.vprofile"));
    let before = scene.read("place.vmap");
    scene.run("map remove current.vmap map-09.png --no-self-test").succeeded();
    assert!(scene.read("place.vmap") != before, "the target of the link is replaced");
    for link in ["current.vprofile", "current.vmap"] {
        assert!(scene.path(link).symlink_metadata().expect("there").is_symlink(), "{link}");
    }
}

/// Results come before files made of them, so that a file that cannot be written costs nothing else.
#[cfg(target_os = "linux")]
#[test]
fn results_are_written_before_other_files() {
    let scene = scene();
    scene.seal("query-0.png", "points", "out.vquery");
    let run = scene.command("localize --map place.vmap --json out.vquery --out-hloc /dev/full");
    let output = { run }.output().expect("the binary runs");
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).expect("the results");
    assert_eq!(document["trusted"], 1, "{CAMERA}");
}
