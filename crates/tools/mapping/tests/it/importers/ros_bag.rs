//! Bags of ROS: what is one, what is asked of the Python package, and when an earlier run is used again.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use veiloc_mapping::MappingError;
use veiloc_mapping::importers::poses::read_posed;
use veiloc_mapping::importers::ros_bag::{BagFrames, BagOptions, frames_of_bag, is_bag};

/// Stands for `python -m veiloc.ros frames BAG --out FOLDER --json …`: writes one image and its pose, and its arguments.
const STAND_IN: &str = r#"#!/bin/sh
here=$(dirname "$0")
echo "$@" >> "$here/calls"
[ -e "$here/fails" ] && { cat "$here/fails" >&2; exit 1; }
out=$6
mkdir -p "$out/images/cam" "$out/posed"
echo pixels > "$out/images/cam/1.png"
echo '1 PINHOLE 40 30 30 30 20 15' > "$out/posed/cameras.txt"
printf '1 1 0 0 0 0 0 0 1 cam/1.png\n\n' > "$out/posed/images.txt"
: > "$out/posed/points3D.txt"
echo '{"stage": "images of the bag", "total": 2}'
echo '{"done": 2}'
echo 'a line of some library'
echo '{"images": 1, "of": 2, "remarks": ["1 images are left out: too dark"], "down": [0.0, 0.0, -1.0], "metres": true}'
"#;

struct Bags(TempDir);

impl Bags {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        let python = folder.path().join("python");
        fs::write(&python, STAND_IN).expect("written");
        fs::set_permissions(&python, fs::Permissions::from_mode(0o755)).expect("made executable");
        fs::create_dir(folder.path().join("walk")).expect("a folder");
        let bags = Self(folder);
        bags.write("walk/metadata.yaml", b"rosbag2_bagfile_information:\n  version: 9\n");
        bags.write("walk/walk_0.mcap", b"\x89MCAP0\r\n...");
        bags
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        fs::write(self.path(name), bytes).expect("written");
    }

    fn frames(&self, bag: &str, folder: &str, options: &BagOptions) -> Result<BagFrames, MappingError> {
        frames_of_bag(&self.path(bag), &self.path(folder), options, Some(&self.path("python")), &())
    }

    fn calls(&self) -> Vec<String> {
        let calls = fs::read_to_string(self.path("calls")).unwrap_or_default();
        calls.lines().map(|line| line.replace(&self.0.path().display().to_string(), "")).collect()
    }
}

#[test]
fn bags_are_told_by_their_content_and_not_read_as_poses() {
    let bags = Bags::new();
    bags.write("old.bag", b"#ROSBAG V2.0\n");
    bags.write("walk_0.db3", b"SQLite format 3\0...");
    bags.write("database.db", b"SQLite format 3\0...");
    bags.write("metadata.yaml", b"name: else\n");
    for bag in ["walk", "walk/walk_0.mcap", "old.bag", "walk_0.db3"] {
        let path = bags.path(bag);
        assert!(is_bag(&path), "{bag}");
        let error = read_posed(&path, &path).expect_err("no poses");
        assert!(matches!(&error, MappingError::UnreadPoses { .. }), "{error}");
        assert!(error.to_string().contains("python -m veiloc.ros frames BAG"), "{error}");
    }
    for other in ["database.db", "", "metadata.yaml", "python", "none"] {
        assert!(!is_bag(&bags.path(other)), "{other:?}");
    }
}

#[test]
fn a_finished_run_of_the_same_bag_is_used_again() {
    let bags = Bags::new();
    let options =
        BagOptions { topics: vec!["/left".into(), "/right".into()], odometry: Some("/odom".into()) };
    let first = bags.frames("walk", "out", &options).expect("frames");
    assert!(!first.is_reused && first.is_metric && first.count == 1);
    assert_eq!(first.remarks, ["1 images are left out: too dark"]);
    assert_eq!(first.down.map(|down| down.in_world()), Some([0.0, 0.0, -1.0]));
    let posed = read_posed(&first.posed, &first.images).expect("a model");
    assert_eq!(posed.images.images()[0].name, "cam/1.png");
    let expected =
        "-m veiloc.ros frames /walk --out /out --json --topic /left --topic /right --odometry /odom";
    assert_eq!(bags.calls(), [expected]);
    let again = bags.frames("walk", "out", &options).expect("frames");
    assert!(again.is_reused && (again.count, again.remarks) == (1, first.remarks));
    assert_eq!(bags.calls().len(), 1);
    // Images that are gone are written again, into the same folder.
    fs::remove_dir_all(bags.path("out/images")).expect("removed");
    assert!(!bags.frames("walk", "out", &options).expect("frames").is_reused);
    // Other topics, another bag, and files of somebody else are not mixed with it.
    let other = BagOptions::default();
    bags.write("walk/walk_1.mcap", b"\x89MCAP0\r\n...");
    fs::create_dir(bags.path("photos")).expect("a folder");
    bags.write("photos/1.jpg", b"pixels");
    for (folder, options, part) in [
        ("out", &other, "another bag"),
        ("out", &options, "another bag"),
        ("photos", &options, "other files"),
    ] {
        let error = bags.frames("walk", folder, options).expect_err("refused").to_string();
        assert!(error.contains(part) && error.contains("give a new folder"), "{error}");
    }
    assert_eq!(bags.calls().len(), 2);
}

#[test]
fn an_interrupted_run_goes_on_and_errors_name_the_remedy() {
    let bags = Bags::new();
    let run = || bags.frames("walk", "out", &BagOptions::default());
    for (log, part) in [
        ("error: /walk: no image has a pose\n", "walk: /walk: no image has a pose"),
        ("python: No module named veiloc.ros\n", "pip install 'veiloc[ros]', or give --python"),
        ("Traceback (most recent call last):\n  ...\nValueError: x\n", "veiloc.ros failed"),
    ] {
        bags.write("fails", log.as_bytes());
        let error = run().expect_err("it fails");
        assert!(matches!(&error, MappingError::Bag { .. }) && error.to_string().contains(part), "{error}");
    }
    fs::remove_file(bags.path("fails")).expect("removed");
    assert!(!run().expect("the folder is of the same bag").is_reused);
    let missing = Path::new("/none/python");
    let error =
        frames_of_bag(&bags.path("walk"), &bags.path("new"), &BagOptions::default(), Some(missing), &());
    let error = error.expect_err("no Python").to_string();
    assert!(error.contains("pip install 'veiloc[ros]'") && error.contains("/none/python"), "{error}");
}
