//! Cached features of map images: one file per image, named by the hash of the image file and of the extraction
//! parameters.

use std::fs;
use std::path::PathBuf;

use crate::MappingError;
use crate::{Extracted, Wanted};
use sha2::{Digest as _, Sha256};
use veiloc_descriptor::{Descriptors, GlobalDescriptor};
use veiloc_map::atomic_file::write_whole;

use crate::build_cache::key::Key;

/// Bytes of the header: number of keypoints, length of the global descriptor.
const HEAD: usize = 16;
/// Bytes of a keypoint: `u v` as f32.
const KEYPOINT: usize = 8;
/// Bytes of the hash at the end.
const HASH: usize = 32;

/// The folder, and what is common to all keys.
#[derive(Debug)]
pub(crate) struct FeatureFolder {
    folder: PathBuf,
    base: Key,
}

impl FeatureFolder {
    pub(crate) const fn new(folder: PathBuf, base: Key) -> Self {
        Self { folder, base }
    }

    /// Returns `None` if the image cannot be read; the extraction then reports why.
    fn file_of(&self, wanted: &Wanted<'_>) -> Option<PathBuf> {
        let mut key = self.base.clone();
        key.debug(&(wanted.size, wanted.limits, wanted.kind, wanted.global));
        key.bytes(&fs::read(wanted.path).ok()?);
        Some(self.folder.join(format!("{}.bin", &key.hex()[..32])))
    }

    pub(crate) fn get(&self, wanted: &Wanted<'_>) -> Option<Extracted> {
        decoded(&fs::read(self.file_of(wanted)?).ok()?, wanted)
    }

    pub(crate) fn keep(&self, wanted: &Wanted<'_>, found: &Extracted) -> Result<(), MappingError> {
        let Some(path) = self.file_of(wanted) else { return Ok(()) };
        write_whole(&path, &encoded(found)).map_err(MappingError::io(&path))
    }
}

/// Layout: number of keypoints, length of the global descriptor, keypoints, descriptors, global descriptor, and the
/// hash of all that.
fn encoded(found: &Extracted) -> Vec<u8> {
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
fn decoded(bytes: &[u8], wanted: &Wanted<'_>) -> Option<Extracted> {
    let (content, hash) = bytes.split_at_checked(bytes.len().checked_sub(HASH)?)?;
    if Sha256::digest(content)[..] != *hash {
        return None;
    }
    let (head, rest) = content.split_at_checked(HEAD)?;
    let number = |at: usize| usize::try_from(u64::from_le_bytes(head[at..at + 8].try_into().ok()?)).ok();
    let (count, global) = (number(0)?, number(8)?);
    let (keypoints, rest) = rest.split_at_checked(count.checked_mul(KEYPOINT)?)?;
    let (descriptors, global) = rest.split_at_checked(rest.len().checked_sub(global)?)?;
    let descriptors = Descriptors::new(wanted.kind, descriptors.to_vec()).ok()?;
    let coordinate = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().expect("four bytes"));
    let global =
        wanted.global.then(|| GlobalDescriptor::new(global.iter().map(|byte| byte.cast_signed()).collect()));
    (descriptors.len() == count).then(|| Extracted {
        keypoints: keypoints
            .chunks_exact(KEYPOINT)
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

    fn wanted(path: &Path, global: bool) -> Wanted<'_> {
        let limits = veiloc_protocol::ExtractionLimits::default();
        Wanted { path, size: (4, 3), limits, kind: DescriptorKind::ROOT_SIFT, global }
    }

    fn some(global: Option<Vec<i8>>) -> Extracted {
        let descriptors = Descriptors::new(DescriptorKind::ROOT_SIFT, (0..=255).collect()).expect("two rows");
        let keypoints = vec![[1.0, 0.1], [2.5, -0.0]];
        Extracted { keypoints, descriptors, global: global.map(GlobalDescriptor::new) }
    }

    #[test]
    fn features_are_read_as_they_were_written_and_damage_is_seen() {
        let path = Path::new("a.png");
        for global in [None, Some(vec![-128, 0, 127])] {
            let wanted = wanted(path, global.is_some());
            let features = some(global);
            let bytes = encoded(&features);
            assert_eq!(decoded(&bytes, &wanted), Some(features));
            for cut in [0, 7, 31, 40, bytes.len() - 1] {
                assert!(decoded(&bytes[..cut], &wanted).is_none(), "{cut} bytes");
            }
            for at in [0, 10, 30, 100, bytes.len() - 1] {
                let mut damaged = bytes.clone();
                damaged[at] ^= 1;
                assert!(decoded(&damaged, &wanted).is_none(), "byte {at}");
            }
        }
    }

    #[test]
    fn another_image_or_another_wish_is_not_answered() {
        let folder = tempfile::tempdir().expect("a folder");
        let image = folder.path().join("a.png");
        fs::write(&image, b"one").expect("written");
        let kept = FeatureFolder::new(folder.path().to_owned(), Key::new("features"));
        let asked = wanted(&image, false);
        assert_eq!(kept.get(&asked), None);
        kept.keep(&asked, &some(None)).expect("kept");
        assert_eq!(kept.get(&asked), Some(some(None)));
        assert_eq!(kept.get(&Wanted { size: (3, 4), ..asked }), None);
        assert_eq!(kept.get(&Wanted { global: true, ..asked }), None);
        let other = FeatureFolder::new(folder.path().to_owned(), Key::new("other weights"));
        assert_eq!(other.get(&asked), None);
        fs::write(&image, b"two").expect("written");
        assert_eq!(kept.get(&asked), None);
        fs::remove_file(&image).expect("removed");
        assert_eq!(kept.get(&asked), None);
    }
}
