//! The profile: what a device needs to seal for a map. It contains no map data.

use std::fmt;

use veiloc_descriptor::{DescriptorKind, GlobalModel, Vocabulary};

use crate::{ProfileId, QueryError};

/// How much to extract from an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ExtractionLimits {
    /// Most keypoints, strongest first. From 256 to 4096.
    pub max_keypoints: u32,
    /// Longest side of the image, pixels; larger images are scaled down first. From 64 to 8192.
    pub max_image_side: u32,
}

/// 2048 keypoints from at most 1600 pixels, as hloc and COLMAP users choose for scenes of a building's size.
impl Default for ExtractionLimits {
    fn default() -> Self {
        Self { max_keypoints: 2048, max_image_side: 1600 }
    }
}

impl ExtractionLimits {
    fn check(self) -> Result<(), QueryError> {
        let Self { max_keypoints, max_image_side } = self;
        if !(256..=4096).contains(&max_keypoints) {
            return Err(QueryError::Field {
                field: "max_keypoints",
                value: max_keypoints,
                allowed: "a number from 256 to 4096",
            });
        }
        if !(64..=8192).contains(&max_image_side) {
            return Err(QueryError::Field {
                field: "max_image_side",
                value: max_image_side,
                allowed: "a number from 64 to 8192",
            });
        }
        Ok(())
    }
}

/// What a device needs to seal for a map, and what the map was built with: the descriptor kind, the global descriptor,
/// and the limits of extraction.
///
/// It does not say how positions are hidden: the device decides that.
#[derive(Clone, PartialEq)]
pub struct Profile {
    pub(crate) kind: DescriptorKind,
    pub(crate) limits: ExtractionLimits,
    pub(crate) global: GlobalModel,
}

impl Profile {
    /// A profile with the default limits.
    ///
    /// # Errors
    /// [`QueryError::Mismatch`] when the vocabulary consists of other descriptors.
    pub fn new(kind: DescriptorKind, global: GlobalModel) -> Result<Self, QueryError> {
        match global.vocabulary() {
            Some(vocabulary) if vocabulary.kind() != kind => Err(QueryError::Mismatch {
                what: "descriptor kind of the vocabulary",
                expected: format!("{kind:?}"),
                actual: format!("{:?}", vocabulary.kind()),
            }),
            _ => Ok(Self { kind, limits: ExtractionLimits::default(), global }),
        }
    }

    /// A profile for the descriptors of a vocabulary, with the default limits.
    pub fn vlad(vocabulary: Vocabulary) -> Self {
        let (kind, limits) = (vocabulary.kind(), ExtractionLimits::default());
        Self { kind, limits, global: GlobalModel::Vlad(vocabulary) }
    }

    /// This profile with other limits.
    ///
    /// # Errors
    /// [`QueryError::Field`] for limits out of range.
    pub fn with_limits(&self, limits: ExtractionLimits) -> Result<Self, QueryError> {
        limits.check()?;
        Ok(Self { limits, ..self.clone() })
    }

    /// How much to extract.
    pub const fn limits(&self) -> ExtractionLimits {
        self.limits
    }

    /// Which descriptors to extract.
    pub const fn descriptor_kind(&self) -> DescriptorKind {
        self.kind
    }

    /// How the global descriptor is computed.
    pub const fn global_model(&self) -> &GlobalModel {
        &self.global
    }

    /// The vocabulary of the global descriptor; `None` when it is not computed from a vocabulary.
    pub const fn vocabulary(&self) -> Option<&Vocabulary> {
        self.global.vocabulary()
    }

    /// The name of this profile: a hash of its bytes.
    pub fn id(&self) -> ProfileId {
        ProfileId::of(&self.encode())
    }
}

impl fmt::Debug for Profile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Profile({}, {}, {}, {:?})", self.id(), self.kind, self.global.name(), self.limits)
    }
}
