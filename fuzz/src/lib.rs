//! Internal: properties of the decoders for arbitrary bytes: an error, or a usable value that encodes to the same bytes.
//!
//! Each says whether the input was accepted. `fuzz/tests/seeds.rs` checks them on mutated inputs in every `cargo test`.

pub mod damage;

use std::fs;
use std::ops::Range;
use std::path::Path;

use sha2::{Digest as _, Sha256};
use veiloc_descriptor::GlobalDescriptor;
use veiloc_map::colmap::{ColmapImage, read_model, write_text};
use veiloc_map::regions::{Manifest, ObjectId, RegionIndex};
use veiloc_map::{MapFile, MapMemory};
use veiloc_protocol::{Answer, Pack, Profile, SealedQuery};
use veiloc_service::auth::{TokenEntry, TokenKey, TokenList, added, revoked};
use xxhash_rust::xxh3::xxh3_64;

/// A sealed query.
pub fn sealed_query(bytes: &[u8]) -> bool {
    let Ok(query) = SealedQuery::decode(bytes) else { return false };
    assert_eq!(query.encode(), bytes, "a query has two encodings");
    assert_eq!(query.observations().len(), query.len());
    let _ = query.check_sides();
    assert!(format!("{query:?}").len() < 100, "Debug prints content");
    true
}

/// A profile.
pub fn profile(bytes: &[u8]) -> bool {
    let Ok(profile) = Profile::decode(bytes) else { return false };
    assert_eq!(profile.encode(), bytes, "a profile has two encodings");
    let _ = profile.id();
    true
}

/// A pack. Its checksum is corrected first, because an attacker can compute it.
pub fn pack(bytes: &[u8]) -> bool {
    let mut bytes = bytes.to_vec();
    if let Some(end) = bytes.len().checked_sub(16) {
        let before = end.saturating_sub(2);
        let checksum = Sha256::digest(&bytes[..before]);
        bytes[end..].copy_from_slice(&checksum[..16]);
    }
    let Ok(pack) = Pack::decode(&bytes) else { return false };
    assert_eq!(pack.encode(), bytes, "a pack has two encodings");
    (0..pack.image_count()).all(|image| pack.image(image).points().iter().all(|p| *p < pack.point_count()))
}

/// An answer.
pub fn answer(bytes: &[u8]) -> bool {
    let Ok(answer) = Answer::decode(bytes) else { return false };
    assert_eq!(answer.encode(), bytes, "an answer has two encodings");
    true
}

/// A map file. Checksums are corrected first, because an attacker can compute them.
pub fn map_file(bytes: &[u8]) -> bool {
    let folder = folder();
    let path = folder.path().join("m.vmap");
    fs::write(&path, with_checksums(bytes)).expect("memory is left");
    let Ok(map) = MapFile::open(&path) else { return false };
    let model = map.to_model();
    model.validate().expect("an opened map is valid");
    let again = folder.path().join("again.vmap");
    veiloc_map::write(&model, &again).expect("an opened map can be written");
    assert_eq!(MapFile::open(&again).expect("a written map opens").to_model(), model);
    true
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
pub fn colmap(bytes: &[u8]) -> bool {
    let Some((kind, rest)) = bytes.split_first() else { return false };
    let extension = if kind & 1 == 0 { "txt" } else { "bin" };
    let folder = folder();
    let mut rest = rest;
    for name in ["cameras", "images", "points3D"] {
        let end = rest.windows(SEPARATOR.len()).position(|w| w == SEPARATOR).unwrap_or(rest.len());
        fs::write(folder.path().join(format!("{name}.{extension}")), &rest[..end]).expect("memory is left");
        rest = rest.get(end + SEPARATOR.len()..).unwrap_or_default();
    }
    let Ok(model) = read_model(folder.path()) else { return false };
    let text = folder.path().join("text");
    write_text(&model, &text).expect("a model that was read can be written");
    let again = read_model(&text).expect("a written model can be read");
    assert_eq!(with_equal_poses(again.images(), model.images()), model.images());
    assert_eq!(again.points(), model.points());
    true
}

/// A manifest: each content has one encoding, and so one id; no name contains a path.
pub fn manifest(bytes: &[u8]) -> bool {
    let Ok(manifest) = Manifest::decode(bytes) else { return false };
    assert_eq!(manifest.encode(), bytes, "a manifest has two encodings");
    assert_eq!(manifest.id(), ObjectId::of(bytes));
    assert!(!manifest.map.contains(['/', '\\', '\0']) && !manifest.map.starts_with(".."));
    for object in manifest.objects() {
        let name = object.sha256.to_string();
        assert!(name.len() == 64 && name.bytes().all(|digit| digit.is_ascii_hexdigit()));
    }
    assert_eq!(manifest.regions.iter().map(|region| region.core_images).sum::<u64>(), manifest.images);
    true
}

/// An index. Its checksum is corrected first, because an attacker can compute it.
pub fn index(bytes: &[u8]) -> bool {
    let mut bytes = bytes.to_vec();
    if let Some(field) = bytes.get_mut(CHECKSUM) {
        field.fill(0);
        let sum = xxh3_64(&bytes).to_le_bytes();
        bytes[CHECKSUM].copy_from_slice(&sum);
    }
    let folder = folder();
    let path = folder.path().join("index");
    fs::write(&path, bytes).expect("memory is left");
    let Ok(index) = RegionIndex::open(&path, MapMemory::Copied) else { return false };
    let regions = 0..index.region_count();
    let mut has_core = vec![false; index.region_count()];
    for image in 0..index.image_count() {
        has_core[index.core_of(image)] = true;
        assert!(
            index.beside(image).all(|region| regions.contains(&region) && region != index.core_of(image))
        );
        assert_eq!(index.global(image).len(), index.global_len());
    }
    assert!(has_core.iter().all(|has_core| *has_core));
    let query = GlobalDescriptor::new(vec![3; index.global_len()]);
    let ranked = index.rank(&query, 10);
    assert!(ranked.iter().all(|entry| regions.contains(&entry.region) && entry.held > 0));
    assert_eq!(ranked.is_empty(), index.image_count() == 0);
    true
}

/// A token file: every entry round-trips, and adding or revoking a token does not change the others.
pub fn tokens(bytes: &[u8]) -> bool {
    let Ok(list) = TokenList::parse(bytes) else { return false };
    let text = std::str::from_utf8(bytes).expect("a parsed file is UTF-8");
    for entry in list.entries() {
        let again: TokenEntry = entry.to_string().parse().expect("a written entry can be read");
        assert!(again == *entry, "an entry has two forms");
        assert!(list.find(&entry.key()) == Some(entry));
        let beginning = entry.key().beginning();
        // A name may itself contain the digits of the hash.
        let by_name = entry.name().contains(&beginning);
        assert!(by_name || !format!("{entry:?}").contains(&beginning), "Debug prints a hash");
        let left = revoked(text, entry.name()).expect("the token exists").text;
        let left = TokenList::parse(left.as_bytes()).expect("the rest is a valid token file");
        let others = list.entries().iter().filter(|other| other.name() != entry.name());
        assert!(others.eq(left.entries()), "another token was changed");
    }
    let new = TokenEntry::new("new", TokenKey::of_digest([7; 32])).expect("a name");
    if let Ok(more) = added(text, &new) {
        let more = TokenList::parse(more.as_bytes()).expect("the result is a valid token file");
        assert!(list.entries().iter().chain([&new]).eq(more.entries()));
    }
    true
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

/// Position of the checksum in an index (`docs/reference/map-format.md`).
const CHECKSUM: Range<usize> = 56..64;

/// Separator of the files in [`colmap`].
const SEPARATOR: &[u8] = b"\n====\n";

/// A temporary folder, in memory if possible.
fn folder() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    let created = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
    created.expect("a temporary folder")
}
