//! A hash of what something is computed from.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use sha2::{Digest as _, Sha256};
use veiloc_features::{Features, Image, load_gray};
use veiloc_geometry::CameraFromWorld;
use veiloc_obfuscation::ExtractError;

use super::io;
use crate::error::EvalError;
use crate::scene::SceneEvaluation;

/// A hash of what something is computed from.
#[derive(Clone)]
pub(super) struct Key(Sha256);

impl Key {
    pub(super) fn new(what: &str) -> Self {
        let mut key = Self(Sha256::new());
        key.text(what);
        key.text(env!("CARGO_PKG_VERSION"));
        key
    }

    pub(super) fn bytes(&mut self, bytes: &[u8]) {
        self.0.update((bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
    }

    pub(super) fn text(&mut self, text: &str) {
        self.bytes(text.as_bytes());
    }

    pub(super) fn debug(&mut self, value: &impl std::fmt::Debug) {
        self.text(&format!("{value:?}"));
    }

    pub(super) fn numbers(&mut self, numbers: impl Iterator<Item = f64>) {
        numbers.for_each(|n| self.0.update(n.to_le_bytes()));
    }

    pub(super) fn pose(&mut self, pose: Option<&CameraFromWorld>) {
        self.debug(&pose.is_some());
        if let Some(pose) = pose {
            self.numbers(pose.rotation().matrix().iter().copied());
            self.numbers(pose.translation().iter().copied());
        }
    }

    /// The content of a file; one that is not there is told apart, and named by whoever needs it.
    pub(super) fn file(&mut self, path: &Path) -> Result<(), EvalError> {
        match fs::read(path) {
            Ok(bytes) => self.bytes(&bytes),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => self.text("no such file"),
            Err(e) => return Err(io(path)(e)),
        }
        Ok(())
    }

    /// What the extractor and the network of global descriptors make of an image: their names do not say which weights they
    /// were read with.
    pub(super) fn behaviour(&mut self, evaluation: &SceneEvaluation) -> Result<(), EvalError> {
        let Some(name) = evaluation.map_list.first() else { return Ok(()) };
        let extractor = evaluation.build.extractors.named(&evaluation.build.features);
        let extractor = extractor.map_err(ExtractError::from)?;
        // An image that cannot be read is named by whoever builds the map.
        let Ok(gray) = load_gray(&evaluation.images.join(name)) else { return Ok(()) };
        let image = Image::from(gray);
        match extractor.stored() {
            // One image does not tell for the others: somebody made each.
            Some(stored) => {
                for name in evaluation.map_list.iter().chain(&evaluation.query_list) {
                    let path = evaluation.images.join(name);
                    let Ok(gray) = load_gray(&path) else { continue };
                    if let Ok(features) = stored.features(&path, (gray.width(), gray.height())) {
                        self.features(&features);
                    }
                }
            }
            None => self.features(&extractor.extract(&image, 64).map_err(ExtractError::from)?),
        }
        if let Some(global) = &evaluation.build.global {
            self.debug(&global.describe(&image).map_err(ExtractError::from)?.as_codes());
        }
        Ok(())
    }

    fn features(&mut self, features: &Features) {
        self.numbers(features.keypoints.iter().flat_map(|k| [k.pixel.u, k.pixel.v]));
        self.bytes(features.descriptors.as_bytes());
    }

    pub(super) fn digest(self) -> [u8; 32] {
        self.0.finalize().into()
    }

    pub(super) fn hex(self) -> String {
        self.digest().iter().fold(String::new(), |mut hex, byte| {
            write!(hex, "{byte:02x}").expect("a string takes all that is written to it");
            hex
        })
    }
}
