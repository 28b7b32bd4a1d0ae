//! The known answers of manifests and indexes of regions.

use std::fs;
use std::path::{Path, PathBuf};

use veiloc_map::regions::{
    FolderWriter, MANIFEST_FILE, Manifest, RegionFolder, RegionIndex, SplitOptions, cut,
};
use veiloc_map::{MapError, MapMemory};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/regions").join(name)
}

/// The manifest and index of a map of two rooms are the known answers.
#[test]
fn known_answers() {
    let map = veiloc_map::MapFile::of_model(&veiloc_testing::rooms(2, 8)).expect("a map");
    let folder = tempfile::tempdir().expect("a folder");
    let regions = cut(&map, &SplitOptions::default().with_images(6)).expect("regions");
    let writer = FolderWriter::begin(&map, "two-rooms", folder.path()).expect("a folder");
    let entries = regions.iter().map(|region| writer.region(region).expect("a region")).collect();
    let manifest = writer.finish(&regions, entries).expect("a manifest");
    let index = RegionFolder::open(folder.path()).expect("regions").path_of(&manifest.index.sha256);
    let files =
        [(folder.path().join(MANIFEST_FILE), "manifest/two-rooms.json"), (index, "index/two-rooms.index")];
    for (written, known) in files {
        if std::env::var_os("VEILOC_BLESS").is_some() {
            fs::copy(&written, data(known)).expect("blessed");
        }
        assert_eq!(fs::read(&written).expect("written"), fs::read(data(known)).expect("known"), "{known}");
    }
    let known = fs::read(data("manifest/two-rooms.json")).expect("known");
    assert_eq!(Manifest::decode(&known).expect("a manifest"), manifest);
    let index = RegionIndex::open(&data("index/two-rooms.index"), MapMemory::Mapped).expect("an index");
    assert_eq!((index.image_count(), index.region_count()), (16, manifest.regions.len()));
}

#[test]
fn other_index_version_has_a_remedy() {
    let mut bytes = fs::read(data("index/two-rooms.index")).expect("known");
    bytes[8..12].copy_from_slice(&2_u32.to_le_bytes());
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("index");
    fs::write(&path, bytes).expect("room");
    let error = RegionIndex::open(&path, MapMemory::Copied).expect_err("another version");
    assert!(matches!(error, MapError::IndexVersion { found: 2, supported: 1, .. }), "{error}");
    assert!(error.to_string().contains("publish the map again"), "{error}");
}
