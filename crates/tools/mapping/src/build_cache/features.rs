//! Cached features of map images: one file per image, named by the hash of the image file and of the extraction
//! parameters.

use std::fs;
use std::path::PathBuf;

use crate::MappingError;
use crate::{ExtractedFeatures, FeatureRequest};
use sha2::{Digest as _, Sha256};
use veiloc_descriptor::{Descriptors, GlobalDescriptor};
use veiloc_map::atomic_file::write_atomic;

use crate::build_cache::key::CacheKey;

/// Bytes of the header: number of keypoints, length of the global descriptor.
const HEADER_BYTES: usize = 16;
/// Bytes of a keypoint: `u v` as f32.
const KEYPOINT_BYTES: usize = 8;
/// Bytes of the hash at the end.
const HASH_BYTES: usize = 32;

/// The folder, and what is common to all keys.
#[derive(Debug)]
pub(crate) struct FeatureFolder {
    folder: PathBuf,
    base: CacheKey,
}

impl FeatureFolder {
    pub(crate) const fn new(folder: PathBuf, base: CacheKey) -> Self {
        Self { folder, base }
    }

    /// Returns `None` if the image cannot be read; the extraction then reports why.
    fn file_of(&self, request: &FeatureRequest<'_>) -> Option<PathBuf> {
        let mut key = self.base.clone();
        key.debug(&(request.size, request.limits, request.kind, request.global));
        key.bytes(&fs::read(request.path).ok()?);
        if let Some(mask) = request.mask {
            key.bytes(&fs::read(mask).ok()?);
        }
        Some(self.folder.join(format!("{}.bin", &key.hex()[..32])))
    }

    pub(crate) fn get(&self, request: &FeatureRequest<'_>) -> Option<ExtractedFeatures> {
        decode(&fs::read(self.file_of(request)?).ok()?, request)
    }

    pub(crate) fn store(
        &self,
        request: &FeatureRequest<'_>,
        found: &ExtractedFeatures,
    ) -> Result<(), MappingError> {
        let Some(path) = self.file_of(request) else { return Ok(()) };
        write_atomic(&path, &encode(found)).map_err(MappingError::io(&path))
    }
}

/// Layout: number of keypoints, length of the global descriptor, keypoints, descriptors, global descriptor, and the
/// hash of all that.
fn encode(found: &ExtractedFeatures) -> Vec<u8> {
    let global = found.global.as_ref().map_or(&[][..], GlobalDescriptor::as_codes);
    let mut bytes = (found.keypoints.len() as u64).to_le_bytes().to_vec();
    bytes.extend((global.len() as u64).to_le_bytes());
    bytes.extend(found.keypoints.iter().flatten().flat_map(|x| x.to_le_bytes()));
    bytes.extend(found.descriptors.as_bytes());
    bytes.extend(global.iter().map(|code| code.cast_unsigned()));
    let hash = Sha256::digest(&bytes);
    bytes.extend(hash);
    bytes
}

/// Returns `None` for a file that is damaged, truncated, or does not fit the request.
fn decode(bytes: &[u8], request: &FeatureRequest<'_>) -> Option<ExtractedFeatures> {
    let (content, hash) = bytes.split_at_checked(bytes.len().checked_sub(HASH_BYTES)?)?;
    if Sha256::digest(content)[..] != *hash {
        return None;
    }
    let (head, rest) = content.split_at_checked(HEADER_BYTES)?;
    let number = |at: usize| usize::try_from(u64::from_le_bytes(head[at..at + 8].try_into().ok()?)).ok();
    let (count, global) = (number(0)?, number(8)?);
    let (keypoints, rest) = rest.split_at_checked(count.checked_mul(KEYPOINT_BYTES)?)?;
    let (descriptors, global) = rest.split_at_checked(rest.len().checked_sub(global)?)?;
    let descriptors = Descriptors::new(request.kind, descriptors.to_vec()).ok()?;
    let coordinate = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().expect("four bytes"));
    let global =
        request.global.then(|| GlobalDescriptor::new(global.iter().map(|byte| byte.cast_signed()).collect()));
    (descriptors.len() == count).then(|| ExtractedFeatures {
        keypoints: keypoints
            .chunks_exact(KEYPOINT_BYTES)
            .map(|k| [coordinate(&k[..4]), coordinate(&k[4..])])
            .collect(),
        descriptors,
        global,
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use veiloc_descriptor::DescriptorKind;

    use super::*;

    fn request(path: &Path, global: bool) -> FeatureRequest<'_> {
        let limits = veiloc_protocol::ExtractionLimits::default();
        FeatureRequest { path, mask: None, size: (4, 3), limits, kind: DescriptorKind::ROOT_SIFT, global }
    }

    fn some(global: Option<Vec<i8>>) -> ExtractedFeatures {
        let descriptors = Descriptors::new(DescriptorKind::ROOT_SIFT, (0..=255).collect()).expect("two rows");
        let keypoints = vec![[1.0, 0.1], [2.5, -0.0]];
        ExtractedFeatures { keypoints, descriptors, global: global.map(GlobalDescriptor::new) }
    }

    #[test]
    fn features_round_trip_and_damage_is_detected() {
        let path = Path::new("a.png");
        for global in [None, Some(vec![-128, 0, 127])] {
            let request = request(path, global.is_some());
            let features = some(global);
            let bytes = encode(&features);
            assert_eq!(decode(&bytes, &request), Some(features));
            for cut in [0, 7, 31, 40, bytes.len() - 1] {
                assert!(decode(&bytes[..cut], &request).is_none(), "{cut} bytes");
            }
            for at in [0, 10, 30, 100, bytes.len() - 1] {
                let mut damaged = bytes.clone();
                damaged[at] ^= 1;
                assert!(decode(&damaged, &request).is_none(), "byte {at}");
            }
        }
    }

    #[test]
    fn changed_image_or_request_misses_the_cache() {
        let folder = tempfile::tempdir().expect("a folder");
        let image = folder.path().join("a.png");
        fs::write(&image, b"one").expect("written");
        let cache = FeatureFolder::new(folder.path().to_owned(), CacheKey::new("features"));
        let request = request(&image, false);
        assert_eq!(cache.get(&request), None);
        cache.store(&request, &some(None)).expect("kept");
        assert_eq!(cache.get(&request), Some(some(None)));
        assert_eq!(cache.get(&FeatureRequest { size: (3, 4), ..request }), None);
        assert_eq!(cache.get(&FeatureRequest { global: true, ..request }), None);
        let other = FeatureFolder::new(folder.path().to_owned(), CacheKey::new("other weights"));
        assert_eq!(other.get(&request), None);
        fs::write(&image, b"two").expect("written");
        assert_eq!(cache.get(&request), None);
        fs::remove_file(&image).expect("removed");
        assert_eq!(cache.get(&request), None);
    }
}
