//! A feature file instead of an extractor.

use std::path::{Component, Path};

use veiloc_descriptor::{DescriptorKind, Encoding};
use veiloc_features::{Extractor, FeatureError, FeatureStore, Features, Image};

use crate::MappingError;
use crate::importers::hloc::FeaturesFile;

/// Features of a file by image name, without extraction.
///
/// An image is found by the end of its path: for `images/db/a.jpg` the file may have `db/a.jpg` or `a.jpg`; if it has
/// both, the image is ambiguous and refused.
#[derive(Debug)]
pub struct StoredFeatures {
    file: FeaturesFile,
    kind: DescriptorKind,
}

impl StoredFeatures {
    /// Opens a file whose descriptors are of a known kind, or of a new kind with this name: signed bytes, as for
    /// network descriptors.
    ///
    /// # Errors
    /// As [`FeaturesFile::open`]; [`MappingError::BadInFile`] if no image has keypoints, the descriptor dimension
    /// differs from the kind's, or the name is invalid.
    pub fn open(path: &Path, name: &str, known: Option<DescriptorKind>) -> Result<Self, MappingError> {
        let file = FeaturesFile::open(path)?;
        let bad =
            |reason: String| MappingError::BadInFile { path: path.to_owned(), name: name.to_owned(), reason };
        let dim = file
            .dim()?
            .ok_or_else(|| bad("no image in the file has descriptors; extract some first".to_owned()))?;
        let kind = match known {
            Some(kind) if kind.dim() == dim => kind,
            Some(kind) => {
                return Err(bad(format!(
                    "its descriptors have {} numbers, and those in the file have {dim}: they are of \
                     another kind; give them their own name with --features",
                    kind.dim()
                )));
            }
            None => {
                let length = (NORM * (dim as f64).sqrt()).round() as u32;
                DescriptorKind::new(name, dim, Encoding::Signed, length).map_err(|e| bad(e.to_string()))?
            }
        };
        Ok(Self { file, kind })
    }

    /// Returns the name of the image at this path in the file.
    fn name_of(&self, path: &Path) -> Result<String, String> {
        let parts: Vec<&str> = path
            .components()
            .filter_map(|part| match part {
                Component::Normal(part) => part.to_str(),
                _ => None,
            })
            .collect();
        let ends = (0..parts.len()).map(|from| parts[from..].join("/"));
        let held: Vec<String> = ends.filter(|name| self.file.holds(name)).collect();
        let file = self.file.path().display();
        match held.as_slice() {
            [name] => Ok(name.clone()),
            [] => Err(format!(
                "{file} has no features of {}; extract them, or remove the image from the list",
                path.display()
            )),
            [one, other, ..] => Err(format!(
                "{file} has both {one} and {other}, and {} may be either; use complete image names in \
                 feature files",
                path.display()
            )),
        }
    }
}

impl Extractor for StoredFeatures {
    fn kind(&self) -> DescriptorKind {
        self.kind
    }

    fn extract(&self, _: &Image, _: usize) -> Result<Features, FeatureError> {
        let reason =
            format!("{} finds images by name, and this image has no name", self.file.path().display());
        Err(FeatureError::Extractor { name: self.kind.name().to_owned(), reason })
    }

    /// The receptive field of typical networks ([`FeatureStore`] has the scale), because the file does not state one
    /// and images were not padded by mirroring.
    fn reach(&self) -> f64 {
        RECEPTIVE_RADIUS
    }

    fn stored(&self) -> Option<&dyn FeatureStore> {
        Some(self)
    }
}

impl FeatureStore for StoredFeatures {
    fn features(&self, path: &Path, size: (u32, u32)) -> Result<Features, FeatureError> {
        let refused = |reason: String| FeatureError::Extractor { name: self.kind.name().to_owned(), reason };
        let name = self.name_of(path).map_err(refused)?;
        let stored = self.file.read(&name).map_err(|e| refused(e.to_string()))?;
        if let Some(of) = stored.image_size.filter(|of| *of != size) {
            return Err(refused(format!(
                "{}: {name} was extracted from an image of {}x{} pixels, and {} has {}x{}; give the \
                 original image",
                self.file.path().display(),
                of.0,
                of.1,
                path.display(),
                size.0,
                size.1
            )));
        }
        // hloc scales images down first, to this side by default, so a keypoint covers more pixels of the original
        // image.
        let scale = (f64::from(size.0.max(size.1)) / DEFAULT_MAX_SIDE).max(1.0) as f32;
        let bad = |reason| refused(format!("{}: {name}: {reason}", self.file.path().display()));
        stored.features(self.kind, scale).map_err(bad)
    }
}

/// A unit vector times 32 square roots of its dimension, as for network kinds (decision 0022).
const NORM: f64 = 32.0;
/// Radius in pixels around a keypoint that a SuperPoint descriptor covers (docs/reference/privacy-rules.md, rule L11).
const RECEPTIVE_RADIUS: f64 = 32.0;
/// hloc's `resize_max` in most of its settings.
const DEFAULT_MAX_SIDE: f64 = 1024.0;
