//! Extractors of one vector per image.

use std::sync::Arc;

use veiloc_descriptor::{GlobalDescriptor, NamedGlobal};

use crate::{FeatureError, Image};

/// Computes global descriptors of images.
///
/// A device sends none unless its owner consents to exactly this model: such a vector reveals more than the rows of a
/// query (rule L14 of docs/reference/privacy-rules.md).
pub trait GlobalExtractor: Send + Sync {
    /// Its model: name and number of codes.
    fn model(&self) -> NamedGlobal;

    /// The vector of an image. Pixels that a mask hid ([`Image::without`]) have no influence on it.
    ///
    /// Equal images must give equal vectors, with any number of threads.
    ///
    /// # Errors
    /// [`FeatureError::Extractor`] when it cannot run.
    fn describe(&self, image: &Image) -> Result<GlobalDescriptor, FeatureError>;
}

/// A shared extractor: a network is read once, for the map and for sealing.
#[derive(Clone)]
pub struct SharedGlobal(Arc<dyn GlobalExtractor>);

impl SharedGlobal {
    /// Shares an extractor.
    pub fn new(extractor: impl GlobalExtractor + 'static) -> Self {
        Self(Arc::new(extractor))
    }

    /// Its model: name and number of codes.
    pub fn model(&self) -> NamedGlobal {
        self.0.model()
    }

    /// As [`GlobalExtractor::describe`], and checks the number of codes.
    ///
    /// # Errors
    /// [`FeatureError::Extractor`].
    pub fn describe(&self, image: &Image) -> Result<GlobalDescriptor, FeatureError> {
        let (model, global) = (self.0.model(), self.0.describe(image)?);
        if global.len() != model.dim() {
            let reason = format!("it made {} codes and not {}", global.len(), model.dim());
            return Err(FeatureError::Extractor { name: model.name().to_owned(), reason });
        }
        Ok(global)
    }
}

impl std::fmt::Debug for SharedGlobal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SharedGlobal({})", self.model().name())
    }
}

/// Equal when they have the same model.
impl PartialEq for SharedGlobal {
    fn eq(&self, other: &Self) -> bool {
        self.model() == other.model()
    }
}
