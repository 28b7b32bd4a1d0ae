//! Every fuzz target on its seeds, on earlier findings, and on a limited number of mutated seeds, as ordinary tests on
//! stable Rust. Findings of the fuzzer go to `fuzz/regressions/TARGET/`.

use std::fs;
use std::path::{Path, PathBuf};

use veiloc_fuzz::damage::SplitMix64;
use veiloc_map::regions::{Manifest, RegionIndex};
use veiloc_map::{MapFile, MapMemory};
use veiloc_protocol::{Answer, Profile, SealedQuery};
use veiloc_service::auth::TokenList;

/// Mutated inputs for each target, of which those that write files have fewer.
const MUTATIONS: usize = 3000;
const MUTATED_FILES: usize = 300;

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name)
}

/// The files in a folder of the repository whose names have this ending.
fn files(name: &str, ending: &str) -> Vec<Vec<u8>> {
    let mut paths: Vec<PathBuf> =
        fs::read_dir(folder(name)).expect("a folder").map(|entry| entry.expect("an entry").path()).collect();
    paths.retain(|path| path.to_str().is_some_and(|path| path.ends_with(ending)));
    paths.sort();
    let read: Vec<Vec<u8>> = paths.iter().map(|path| fs::read(path).expect("a file")).collect();
    assert!(!read.is_empty(), "no seed *{ending} in {name}");
    read
}

/// Runs a target on its seeds, which it must accept, then on findings, then on mutated seeds.
fn run(
    target: &str,
    mutations: usize,
    seeds: &[Vec<u8>],
    is_accepted: impl Fn(&[u8]) -> bool,
    property: impl Fn(&[u8]),
) {
    for (index, seed) in seeds.iter().enumerate() {
        assert!(is_accepted(seed), "{target}: seed {index} is refused, so it tests nothing");
        property(seed);
    }
    let found = folder("fuzz/regressions").join(target);
    if found.is_dir() {
        for bytes in files(&format!("fuzz/regressions/{target}"), "") {
            property(&bytes);
        }
    }
    let mut numbers = SplitMix64(1);
    for _ in 0..mutations {
        let (one, other) = (numbers.below(seeds.len()), numbers.below(seeds.len()));
        property(&numbers.mutated(&seeds[one], &seeds[other]));
    }
}

#[test]
fn sealed_query() {
    let seeds = files("crates/core/protocol/tests/data", ".vquery");
    run(
        "sealed_query",
        MUTATIONS,
        &seeds,
        |bytes| SealedQuery::decode(bytes).is_ok(),
        veiloc_fuzz::sealed_query,
    );
}

#[test]
fn profile() {
    let seeds = files("crates/core/protocol/tests/data", ".profile");
    run("profile", MUTATIONS, &seeds, |bytes| Profile::decode(bytes).is_ok(), veiloc_fuzz::profile);
}

#[test]
fn answer() {
    let seeds = files("crates/core/protocol/tests/data", ".answer");
    run("answer", MUTATIONS, &seeds, |bytes| Answer::decode(bytes).is_ok(), veiloc_fuzz::answer);
}

#[test]
fn map_file() {
    let opens = |bytes: &[u8]| {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("m.vmap");
        fs::write(&path, bytes).expect("room");
        MapFile::open(&path).is_ok()
    };
    run(
        "map_file",
        MUTATED_FILES,
        &files("crates/server/map/tests/data", ".bin"),
        opens,
        veiloc_fuzz::map_file,
    );
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
    let is_model = |bytes: &[u8]| {
        let folder = tempfile::tempdir().expect("a folder");
        let extension = if bytes[0] & 1 == 0 { "txt" } else { "bin" };
        let text = bytes[1..].to_vec();
        let mut parts = Vec::new();
        let mut rest = text.as_slice();
        while let Some(end) = rest.windows(6).position(|w| w == b"\n====\n") {
            parts.push(&rest[..end]);
            rest = &rest[end + 6..];
        }
        parts.push(rest);
        for (name, part) in ["cameras", "images", "points3D"].iter().zip(parts) {
            fs::write(folder.path().join(format!("{name}.{extension}")), part).expect("room");
        }
        veiloc_map::colmap::read_model(folder.path()).is_ok()
    };
    run("colmap", MUTATED_FILES, &seeds, is_model, veiloc_fuzz::colmap);
}

#[test]
fn tokens() {
    let seeds = files("crates/server/service/tests/data/auth", ".tokens");
    run("tokens", MUTATIONS, &seeds, |bytes| TokenList::parse(bytes).is_ok(), veiloc_fuzz::tokens);
}

#[test]
fn manifest() {
    let seeds = files("crates/server/map/tests/data/regions/manifest", ".json");
    run("manifest", MUTATIONS, &seeds, |bytes| Manifest::decode(bytes).is_ok(), veiloc_fuzz::manifest);
}

#[test]
fn index() {
    let opens = |bytes: &[u8]| {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("index");
        fs::write(&path, bytes).expect("room");
        RegionIndex::open(&path, MapMemory::Copied).is_ok()
    };
    run(
        "index",
        MUTATED_FILES,
        &files("crates/server/map/tests/data/regions/index", ".index"),
        opens,
        veiloc_fuzz::index,
    );
}
