//! What makes features of an image, by name: SIFT, and whatever else a program brings.

use std::sync::Arc;

use veiloc_descriptor::DescriptorKind;

use crate::{Border, FeatureError, Features, Image, SiftOptions, extract_sift};

/// Makes features of one kind.
///
/// One axis varies: how keypoints are found and described. Reading files, checking their size and making them smaller
/// is the same for all, see [`extract_image`](crate::extract_image).
pub trait Extractor: Send + Sync {
    /// The kind of its descriptors; its name is the extractor's name.
    fn kind(&self) -> DescriptorKind;

    /// The `max_keypoints` strongest features of an image, strongest first, in the image's own pixels (COLMAP's
    /// convention: the centre of the first pixel is at (0.5, 0.5)).
    ///
    /// Equal images must give equal features, with any number of threads. An image without structure gives none.
    ///
    /// # Errors
    /// [`FeatureError::Extractor`] when it cannot run.
    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError>;

    /// How far from a keypoint its descriptor looks, as a multiple of the keypoint's scale.
    ///
    /// A descriptor that looks over the image's border shows that it does, and with that where its keypoint is: a device
    /// leaves it out ([`Features::whole`], rule L11 of docs/privacy.md). 0 keeps all, and is right only for descriptors
    /// that show nothing of the kind.
    fn reach(&self) -> f64;

    /// How far from a keypoint its descriptor looks, as a multiple of the keypoint's scale, whether or not an image's border
    /// would show: keypoints that look so under a mask are left out. That of [`Self::reach`] unless said otherwise.
    fn sight(&self) -> f64 {
        self.reach()
    }
}

/// [`extract_sift`] as an [`Extractor`].
#[derive(Debug, Clone, Default)]
pub struct Sift {
    /// How keypoints are found; the number of them is the caller's, not these options'.
    pub options: SiftOptions,
}

impl Extractor for Sift {
    fn kind(&self) -> DescriptorKind {
        DescriptorKind::ROOT_SIFT
    }

    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError> {
        let mut options = self.options.clone();
        options.max_keypoints = max_keypoints;
        Ok(extract_sift(image.gray(), &options))
    }

    fn reach(&self) -> f64 {
        match self.options.border {
            Border::Cut => crate::sift::REACH,
            Border::Mirrored => 0.0,
        }
    }

    fn sight(&self) -> f64 {
        crate::sift::REACH
    }
}

impl Sift {
    /// As a device describes what it sends: the image's border does not show ([`Border::Mirrored`]).
    pub fn for_sealing() -> Self {
        Self { options: SiftOptions { border: Border::Mirrored, ..SiftOptions::default() } }
    }
}

/// The extractors a program has.
#[derive(Clone)]
pub struct Extractors(Vec<Arc<dyn Extractor>>);

impl std::fmt::Debug for Extractors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Extractors({})", self.names())
    }
}

/// The built-in ones: SIFT.
impl Default for Extractors {
    fn default() -> Self {
        Self(vec![Arc::new(Sift::default())])
    }
}

impl Extractors {
    /// The built-in ones as a device uses them for what it sends ([`Sift::for_sealing`]).
    pub fn for_sealing() -> Self {
        Self(vec![Arc::new(Sift::for_sealing())])
    }

    /// These and one more; it takes the place of one with the same name.
    #[must_use]
    pub fn with(mut self, extractor: impl Extractor + 'static) -> Self {
        let kind = extractor.kind();
        self.0.retain(|known| known.kind().name() != kind.name());
        self.0.push(Arc::new(extractor));
        self
    }

    /// The one with this name, as on the command line.
    ///
    /// # Errors
    /// [`FeatureError::UnknownKind`], naming those there are.
    pub fn named(&self, name: &str) -> Result<&dyn Extractor, FeatureError> {
        let found = self.0.iter().find(|extractor| extractor.kind().name() == name);
        found.map(AsRef::as_ref).ok_or_else(|| self.unknown(name))
    }

    /// The one that makes descriptors of exactly this kind, as a map or a profile asks for them.
    ///
    /// # Errors
    /// [`FeatureError::UnknownKind`], also for a known name with other numbers.
    pub fn of_kind(&self, kind: DescriptorKind) -> Result<&dyn Extractor, FeatureError> {
        let found = self.0.iter().find(|extractor| extractor.kind() == kind);
        found.map(AsRef::as_ref).ok_or_else(|| self.unknown(&format!("{kind:?}")))
    }

    fn unknown(&self, asked: &str) -> FeatureError {
        // What was asked for may come from a file or a server.
        FeatureError::UnknownKind { asked: asked.chars().take(80).collect(), known: self.names() }
    }

    /// Their names, separated by commas.
    pub fn names(&self) -> String {
        self.0.iter().map(|e| e.kind().name().to_owned()).collect::<Vec<_>>().join(", ")
    }
}
