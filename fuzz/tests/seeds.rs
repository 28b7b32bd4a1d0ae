//! Every fuzz target on its seeds, on earlier findings, and on a limited number of mutated seeds, as ordinary tests on
//! stable Rust. Findings of the fuzzer go to `fuzz/regressions/TARGET/`.

use std::fs;
use std::path::{Path, PathBuf};

use veiloc_fuzz::damage;

/// Mutated inputs for each target, of which those that write files have fewer.
const MUTATIONS: usize = 3000;
const MUTATED_FILES: usize = 300;

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name)
}

/// Checks a target on its seeds, mutated seeds and earlier findings.
fn check(target: &str, mutations: usize, seeds: &[Vec<u8>], property: impl Fn(&[u8]) -> bool) {
    damage::check(seeds, mutations, &property);
    let found = folder("fuzz/regressions").join(target);
    if found.is_dir() {
        for bytes in damage::files(&found, "") {
            property(&bytes);
        }
    }
}

macro_rules! targets {
    ($($target:ident: $mutations:ident of $ending:literal in $folder:literal),* $(,)?) => {
        $(#[test]
        fn $target() {
            let seeds = damage::files(&folder($folder), $ending);
            check(stringify!($target), $mutations, &seeds, veiloc_fuzz::$target);
        })*
    };
}

targets! {
    sealed_query: MUTATIONS of ".vquery" in "crates/core/protocol/tests/data",
    profile: MUTATIONS of ".profile" in "crates/core/protocol/tests/data",
    pack: MUTATIONS of ".vpack" in "crates/core/protocol/tests/data",
    answer: MUTATIONS of ".answer" in "crates/core/protocol/tests/data",
    tokens: MUTATIONS of ".tokens" in "crates/server/service/tests/data/auth",
    manifest: MUTATIONS of ".json" in "crates/server/map/tests/data/regions/manifest",
    index: MUTATED_FILES of ".index" in "crates/server/map/tests/data/regions/index",
    map_file: MUTATED_FILES of ".bin" in "crates/server/map/tests/data",
}

/// The files of a COLMAP model as one seed: a byte that selects text or binary, then the three files.
#[test]
fn colmap() {
    let mut seeds = Vec::new();
    let models = folder("crates/server/map/tests/data/colmap");
    for entry in fs::read_dir(&models).expect("models") {
        let model = entry.expect("an entry").path();
        for (extension, mark) in [("txt", b'0'), ("bin", b'1')] {
            let read = |name: &str| fs::read(model.join(format!("{name}.{extension}")));
            let Ok(cameras) = read("cameras") else { continue };
            let [images, points] = ["images", "points3D"].map(|name| read(name).expect("beside the cameras"));
            seeds.push([&[mark][..], &cameras, b"\n====\n", &images, b"\n====\n", &points].concat());
        }
    }
    assert!(seeds.len() >= 2, "a text and a binary model");
    seeds.sort();
    check("colmap", MUTATED_FILES, &seeds, veiloc_fuzz::colmap);
}
