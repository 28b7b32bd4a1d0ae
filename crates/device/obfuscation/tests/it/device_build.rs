//! Programs for devices are never built with the cargo feature `ground-truth`, so they do not contain the functions
//! that return the ground truth.

use std::process::Command;

/// The packages that apps link, with their features; none of their dependencies may enable `ground-truth`.
const DEVICE: [&[&str]; 5] = [
    &["veiloc-features"],
    &["veiloc-obfuscation"],
    &["veiloc-client"],
    &["veiloc-web"],
    &["veiloc", "--no-default-features", "--features", "device"],
];

/// All crates that are built for a package, with their features, as cargo resolves them for this package alone.
fn built(package: &[&str]) -> String {
    let output = Command::new(env!("CARGO"))
        .args([
            "tree",
            "--offline",
            "--edges",
            "normal,build",
            "--prefix",
            "none",
            "--format",
            "{p} [{f}]",
            "--package",
        ])
        .args(package)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("cargo writes UTF-8")
}

#[test]
fn device_packages_exclude_ground_truth() {
    for package in DEVICE {
        let tree = built(package);
        assert!(tree.contains(package[0]), "{tree}");
        let with_ground_truth: Vec<&str> =
            tree.lines().filter(|line| line.contains("ground-truth")).collect();
        assert!(
            with_ground_truth.is_empty(),
            "{package:?} would be built with the ground truth: {with_ground_truth:?}"
        );
    }
    // Check of the search itself: the command line also evaluates, so it enables the feature.
    assert!(built(&["veiloc-cli"]).contains("ground-truth"), "the search does not find the feature");
}
