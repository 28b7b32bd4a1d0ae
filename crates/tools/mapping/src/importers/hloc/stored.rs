//! A feature file instead of an extractor.

use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use veiloc_descriptor::{DescriptorKind, Encoding};
use veiloc_features::{Extractor, FeatureError, FeatureStore, Features, Image};

use crate::MappingError;
use crate::importers::hloc::FeaturesFile;
use crate::input::image_names::{NameIndex, other_spellings};

/// Features of a file by image name, without extraction.
///
/// For images that are known together ([`FeatureStore::of_images`]) the name relative to their folder counts first. Only
/// if the file does not have it, an end of the path counts: for `images/db/a.jpg` the file may have `images/db/a.jpg`,
/// `db/a.jpg` or `a.jpg`, of which the longest counts. An end that is another image's name, or that fits another image
/// as well, is refused.
#[derive(Debug, Clone)]
pub struct StoredFeatures {
    file: Arc<FeaturesFile>,
    kind: DescriptorKind,
    images: Option<Arc<ImageNames>>,
}

/// Images that are known together.
#[derive(Debug)]
struct ImageNames {
    folder: PathBuf,
    /// Relative to the folder.
    names: Vec<String>,
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
        Ok(Self { file: Arc::new(file), kind, images: None })
    }

    /// Returns the name of the image at this path in the file.
    fn name_of(&self, path: &Path) -> Result<String, String> {
        let inside = |images: &ImageNames| path.strip_prefix(&images.folder).ok().map(joined);
        let relative = self.images.as_deref().and_then(inside);
        if let Some(held) = relative.as_deref().and_then(|name| self.held(name)) {
            return Ok(held);
        }
        let file = self.file.path().display();
        let Some(end) = self.held_end(&joined(path)) else {
            return Err(format!(
                "{file} has no features of {}; extract them, or remove the image from the list",
                path.display()
            ));
        };
        let other = match (&self.images, relative) {
            (Some(images), Some(own)) => self.other_image(images, &own, &end),
            _ => other_file(path, &end).map(|other| other.display().to_string()),
        };
        match other {
            Some(other) => Err(format!(
                "{file} has no features of {}, and its {end} may be those of {other}; use image names relative to the \
                 folder of the images in feature files",
                path.display()
            )),
            None => Ok(end),
        }
    }

    /// Returns the name in the file, in the spelling that it has there.
    fn held(&self, name: &str) -> Option<String> {
        let mut spellings = std::iter::once(name.to_owned()).chain(other_spellings(name));
        spellings.find(|name| self.file.holds(name))
    }

    /// Returns the longest end of a path that the file has.
    fn held_end(&self, path: &str) -> Option<String> {
        let starts = std::iter::once(0).chain(path.match_indices('/').map(|(at, _)| at + 1));
        starts.map(|at| &path[at..]).find_map(|end| self.held(end))
    }

    /// Returns another of the images whose features these are, or may be.
    fn other_image(&self, images: &ImageNames, own: &str, end: &str) -> Option<String> {
        let index = NameIndex::new([(end, ())]);
        let fits = |name: &str| {
            let starts = std::iter::once(0).chain(name.match_indices('/').map(|(at, _)| at + 1));
            let mut ends = starts.map(|at| &name[at..]);
            ends.any(|part| index.get(part).is_some())
                && (index.get(name).is_some() || self.held(name).is_none())
        };
        images.names.iter().find(|name| *name != own && fits(name)).cloned()
    }
}

/// The parts of a path that name something, with `/`.
fn joined(path: &Path) -> String {
    let parts = path.components().filter_map(|part| match part {
        Component::Normal(part) => part.to_str(),
        _ => None,
    });
    parts.collect::<Vec<_>>().join("/")
}

/// Another image file whose name relative to a folder above this image is `end`.
fn other_file(path: &Path, end: &str) -> Option<PathBuf> {
    let mut others = path.ancestors().skip(2).map(|folder| folder.join(end));
    others.find(|other| other != path && other.is_file())
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
    fn support_radius(&self) -> f64 {
        RECEPTIVE_RADIUS
    }

    fn stored(&self) -> Option<&dyn FeatureStore> {
        Some(self)
    }
}

impl FeatureStore for StoredFeatures {
    fn of_images(&self, folder: &Path, names: &[&str]) -> Option<Arc<dyn Extractor>> {
        let names = names.iter().map(|name| joined(Path::new(name))).collect();
        let images = Some(Arc::new(ImageNames { folder: folder.to_owned(), names }));
        Some(Arc::new(Self { images, ..self.clone() }))
    }

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
