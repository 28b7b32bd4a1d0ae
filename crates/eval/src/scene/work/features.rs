//! Features of map images, kept: one file an image, named by the hash of its pixels and of what makes features of it.

use std::fs;
use std::path::PathBuf;
use std::sync::Arc;

use sha2::{Digest as _, Sha256};
use veiloc_descriptor::{DescriptorKind, Descriptors};
use veiloc_features::{Extractor, Extractors, FeatureError, Features, Image, Keypoint, Stored};
use veiloc_geometry::Pixel;
use veiloc_mapping::BuildOptions;
use veiloc_replacing::write_whole;

use super::key::Key;
use super::{Work, io};
use crate::error::EvalError;
use crate::scene::SceneEvaluation;

/// Bytes of a keypoint: `u v` as f64, scale, orientation and response as f32.
const KEYPOINT: usize = 28;
/// Bytes of the hash at the end.
const HASH: usize = 32;

impl Work {
    /// The options with an extractor that keeps what it makes.
    pub(in crate::scene) fn keeping_features(
        &self,
        evaluation: &SceneEvaluation,
    ) -> Result<BuildOptions, EvalError> {
        let folder = self.folder.join("features");
        fs::create_dir_all(&folder).map_err(io(&folder))?;
        let mut base = Key::new("features");
        base.behaviour(evaluation)?;
        let inner = evaluation.build.extractors.shared(&evaluation.build.features);
        let inner = inner.map_err(veiloc_obfuscation::ExtractError::from)?;
        let mut options = evaluation.build.clone();
        options.extractors = Extractors::default().with(Keeping { inner, folder, base });
        Ok(options)
    }
}

/// An extractor that keeps what it makes.
struct Keeping {
    inner: Arc<dyn Extractor>,
    folder: PathBuf,
    base: Key,
}

impl Extractor for Keeping {
    fn kind(&self) -> DescriptorKind {
        self.inner.kind()
    }

    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError> {
        let mut key = self.base.clone();
        key.debug(&(image.width(), image.height(), max_keypoints));
        let samples: Vec<u8> = image.gray().data().iter().flat_map(|sample| sample.to_le_bytes()).collect();
        key.bytes(&samples);
        let path = self.folder.join(format!("{}.bin", &key.hex()[..32]));
        // What is not there, or damaged, is made again.
        if let Some(kept) = fs::read(&path).ok().and_then(|bytes| decoded(&bytes, self.kind())) {
            return Ok(kept);
        }
        let features = self.inner.extract(image, max_keypoints)?;
        write_whole(&path, &encoded(&features)).map_err(|e| FeatureError::Extractor {
            name: self.kind().name().to_owned(),
            reason: format!("{}: {e}", path.display()),
        })?;
        Ok(features)
    }

    fn reach(&self) -> f64 {
        self.inner.reach()
    }

    fn sight(&self) -> f64 {
        self.inner.sight()
    }

    /// What is looked up need not be kept.
    fn stored(&self) -> Option<&dyn Stored> {
        self.inner.stored()
    }
}

/// Number of keypoints, keypoints, descriptors, and the hash of all that.
fn encoded(features: &Features) -> Vec<u8> {
    let mut bytes = (features.keypoints.len() as u64).to_le_bytes().to_vec();
    for k in &features.keypoints {
        bytes.extend([k.pixel.u, k.pixel.v].iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend([k.scale, k.orientation, k.response].iter().flat_map(|x| x.to_le_bytes()));
    }
    bytes.extend(features.descriptors.as_bytes());
    let hash = Sha256::digest(&bytes);
    bytes.extend(hash);
    bytes
}

/// `None` for what was not written so, whole.
fn decoded(bytes: &[u8], kind: DescriptorKind) -> Option<Features> {
    let (content, hash) = bytes.split_at_checked(bytes.len().checked_sub(HASH)?)?;
    if Sha256::digest(content)[..] != *hash {
        return None;
    }
    let (count, rest) = content.split_first_chunk::<8>()?;
    let count = usize::try_from(u64::from_le_bytes(*count)).ok()?;
    let (keypoints, descriptors) = rest.split_at_checked(count.checked_mul(KEYPOINT)?)?;
    let keypoints = keypoints.chunks_exact(KEYPOINT).map(|k| {
        let long = |at: usize| f64::from_le_bytes(k[at..at + 8].try_into().expect("eight bytes"));
        let short = |at: usize| f32::from_le_bytes(k[at..at + 4].try_into().expect("four bytes"));
        Keypoint {
            pixel: Pixel::new(long(0), long(8)),
            scale: short(16),
            orientation: short(20),
            response: short(24),
        }
    });
    let descriptors = Descriptors::new(kind, descriptors.to_vec()).ok()?;
    (descriptors.len() == count).then(|| Features {
        keypoints: keypoints.collect(),
        descriptors,
        global: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn features_are_read_as_they_were_written_and_damage_is_seen() {
        let kind = DescriptorKind::ROOT_SIFT;
        let keypoint =
            |u: f64| Keypoint { pixel: Pixel::new(u, 0.1 + u), scale: 1.5, orientation: -2.0, response: 0.3 };
        let descriptors = Descriptors::new(kind, (0..=255).collect()).expect("two rows");
        let features = Features { keypoints: vec![keypoint(1.0), keypoint(2.5)], descriptors, global: None };
        let bytes = encoded(&features);
        assert!(decoded(&bytes, kind).is_some_and(|read| read == features));
        for cut in [0, 7, 31, 40, bytes.len() - 1] {
            assert!(decoded(&bytes[..cut], kind).is_none(), "{cut} bytes");
        }
        for at in [0, 20, 100, bytes.len() - 1] {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1;
            assert!(decoded(&damaged, kind).is_none(), "byte {at}");
        }
    }
}
