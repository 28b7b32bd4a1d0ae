//! What a program for devices is built of never has the cargo feature `ground-truth`: the functions that keep the answers are not in it.

use std::process::Command;

/// What apps link, and with which features; whatever it reaches must do without the answers.
const DEVICE: [&[&str]; 5] = [
    &["veiloc-features"],
    &["veiloc-obfuscation"],
    &["veiloc-client"],
    &["veiloc-web"],
    &["veiloc", "--no-default-features", "--features", "device"],
];

/// How a package is built: each crate in it, with its features, as cargo resolves them for this package alone.
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
fn nothing_for_devices_is_built_with_the_answers() {
    for package in DEVICE {
        let tree = built(package);
        assert!(tree.contains(package[0]), "{tree}");
        let with_answers: Vec<&str> = tree.lines().filter(|line| line.contains("ground-truth")).collect();
        assert!(with_answers.is_empty(), "{package:?} would be built with the answers: {with_answers:?}");
    }
    // The search finds the feature where it is: the command line evaluates too.
    assert!(built(&["veiloc-cli"]).contains("ground-truth"), "the search does not find what is there");
}
