//! Properties of any manifest and any index of regions. `crates/server/map/tests/it/regions/any_bytes.rs` includes this
//! file.

use veiloc_descriptor::GlobalDescriptor;
use veiloc_map::MapMemory;
use veiloc_map::regions::{Manifest, ObjectId, RegionIndex};
use xxhash_rust::xxh3::xxh3_64;

/// A manifest: each content has one encoding, and so one id; no name contains a path.
pub fn manifest(bytes: &[u8]) {
    let Ok(manifest) = Manifest::decode(bytes) else { return };
    assert_eq!(manifest.encode(), bytes, "a manifest has two encodings");
    assert_eq!(manifest.id(), ObjectId::of(bytes));
    assert!(!manifest.map.contains(['/', '\\', '\0']) && !manifest.map.starts_with(".."));
    for object in manifest.objects() {
        let name = object.sha256.to_string();
        assert!(name.len() == 64 && name.bytes().all(|digit| digit.is_ascii_hexdigit()));
    }
    assert_eq!(manifest.regions.iter().map(|region| region.core_images).sum::<u64>(), manifest.images);
}

/// An index. Its checksum is corrected first, because an attacker can compute it.
pub fn index(bytes: &[u8]) {
    let mut bytes = bytes.to_vec();
    if let Some(field) = bytes.get_mut(CHECKSUM) {
        field.fill(0);
        let sum = xxh3_64(&bytes).to_le_bytes();
        bytes[CHECKSUM].copy_from_slice(&sum);
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("index");
    std::fs::write(&path, bytes).expect("space is left");
    let Ok(index) = RegionIndex::open(&path, MapMemory::Copied) else { return };
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
}

/// Position of the checksum in an index (`docs/reference/map-format.md`).
const CHECKSUM: std::ops::Range<usize> = 56..64;
