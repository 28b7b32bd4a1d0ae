//! Properties of the decoders for arbitrary bytes: an error, or a usable value that encodes to the same bytes.
//!
//! The same properties run on mutated inputs in every `cargo test`: `fuzz/tests/seeds.rs`,
//! `crates/core/protocol/tests/it/hostile.rs`, `crates/core/protocol/tests/it/answer.rs`,
//! `crates/server/map/src/file/tests.rs`, `crates/server/map/tests/it/any_bytes.rs`,
//! `crates/server/service/tests/it/auth/any_bytes.rs`, `crates/tools/cli/tests/it/args/any_bytes.rs`,
//! `crates/server/map/tests/it/regions/any_bytes.rs`.

pub mod damage;
mod regions;
mod tokens;

use std::fs;
use std::path::Path;

use veiloc_map::MapFile;
use veiloc_map::colmap::{ColmapImage, read_model, write_text};
use veiloc_protocol::{Answer, Profile, SealedQuery};
use xxhash_rust::xxh3::xxh3_64;

pub use regions::{index, manifest};
pub use tokens::tokens;

/// A sealed query.
pub fn sealed_query(bytes: &[u8]) {
    let Ok(query) = SealedQuery::decode(bytes) else { return };
    assert_eq!(query.encode(), bytes, "a query has two encodings");
    assert_eq!(query.observations().len(), query.len());
    let _ = query.check_sides();
    assert!(format!("{query:?}").len() < 100, "Debug prints content");
}

/// A profile.
pub fn profile(bytes: &[u8]) {
    let Ok(profile) = Profile::decode(bytes) else { return };
    assert_eq!(profile.encode(), bytes, "a profile has two encodings");
    let _ = profile.id();
}

/// An answer.
pub fn answer(bytes: &[u8]) {
    let Ok(answer) = Answer::decode(bytes) else { return };
    assert_eq!(answer.encode(), bytes, "an answer has two encodings");
}

/// A map file. Checksums are corrected first, because an attacker can compute them.
pub fn map_file(bytes: &[u8]) {
    let folder = folder();
    let path = folder.path().join("m.vmap");
    fs::write(&path, with_checksums(bytes)).expect("memory is left");
    let Ok(map) = MapFile::open(&path) else { return };
    let model = map.to_model();
    model.validate().expect("an opened map is valid");
    let again = folder.path().join("again.vmap");
    veiloc_map::write(&model, &again).expect("an opened map can be written");
    assert_eq!(MapFile::open(&again).expect("a written map opens").to_model(), model);
}

/// Corrects the checksums: a header of 64 bytes, then its number of entries of 32 bytes (`docs/reference/map-format.md`).
fn with_checksums(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let sections = bytes.get(12..16).and_then(|n| n.try_into().ok()).map_or(0, u32::from_le_bytes);
    let head = (sections as usize).saturating_mul(32).saturating_add(64);
    if bytes.len() < head {
        return bytes;
    }
    for entry in (64..head).step_by(32) {
        let number = |at: usize| {
            usize::try_from(u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))).ok()
        };
        let range = number(entry + 8).and_then(|start| Some(start..start.checked_add(number(entry + 16)?)?));
        if let Some(section) = range.and_then(|range| bytes.get(range)) {
            let sum = xxh3_64(section).to_le_bytes();
            bytes[entry + 24..entry + 32].copy_from_slice(&sum);
        }
    }
    bytes[24..32].fill(0);
    let sum = xxh3_64(&bytes[..head]).to_le_bytes();
    bytes[24..32].copy_from_slice(&sum);
    bytes
}

/// A COLMAP model. The first byte selects text or binary; the three files follow, separated by a line `====`.
pub fn colmap(bytes: &[u8]) {
    let Some((kind, rest)) = bytes.split_first() else { return };
    let extension = if kind & 1 == 0 { "txt" } else { "bin" };
    let folder = folder();
    let mut rest = rest;
    for name in ["cameras", "images", "points3D"] {
        let end = rest.windows(SEPARATOR.len()).position(|w| w == SEPARATOR).unwrap_or(rest.len());
        fs::write(folder.path().join(format!("{name}.{extension}")), &rest[..end]).expect("memory is left");
        rest = rest.get(end + SEPARATOR.len()..).unwrap_or_default();
    }
    let Ok(model) = read_model(folder.path()) else { return };
    let text = folder.path().join("text");
    write_text(&model, &text).expect("a model that was read can be written");
    let again = read_model(&text).expect("a written model can be read");
    assert_eq!(with_equal_poses(again.images(), model.images()), model.images());
    assert_eq!(again.points(), model.points());
}

/// The images, with the poses of `others` where they agree up to rounding: a rotation is stored as a matrix and written
/// as a quaternion, and the conversion may change the last bits.
fn with_equal_poses(images: &[ColmapImage], others: &[ColmapImage]) -> Vec<ColmapImage> {
    let mut images = images.to_vec();
    for (image, other) in images.iter_mut().zip(others) {
        let (ours, theirs) = (image.cam_from_world, other.cam_from_world);
        if ours.translation() == theirs.translation() && ours.rotation_error_degrees(&theirs) < 1e-12 {
            image.cam_from_world = theirs;
        }
    }
    images
}

/// Separator of the files in [`colmap`].
const SEPARATOR: &[u8] = b"\n====\n";

/// A temporary folder, in memory if possible.
fn folder() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    let created = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
    created.expect("a temporary folder")
}
