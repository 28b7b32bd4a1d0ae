//! What a device needs to know before it can seal for a map: the profile. It contains no map data.

use std::fmt;

use prost::Message;
use sha2::{Digest, Sha256};
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};

use crate::wire::{ProfileMessage, VERSION, parse, present};
use crate::{AngleBits, QueryError, Scheme, SealedQuery};

/// Most bytes a profile may have: the largest vocabulary and the fields around it.
const MAX_BYTES: usize = Vocabulary::MAX_LEN * 128 + 4096;

/// How much to extract from an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ExtractionLimits {
    /// Most keypoints, strongest first. From 256 to 4096.
    pub max_keypoints: u32,
    /// Longest side of the image, pixels; larger images are made smaller first. From 64 to 8192.
    pub max_image_side: u32,
}

/// 2048 keypoints from at most 1600 pixels, which is what hloc and COLMAP users do for scenes of a building's size.
impl Default for ExtractionLimits {
    fn default() -> Self {
        Self { max_keypoints: 2048, max_image_side: 1600 }
    }
}

/// What a device needs to seal for a map, and what a map was built with.
///
/// The scheme in a profile is the operator's wish. The device decides: [`Self::with_scheme`] changes it without
/// making the query useless to the map, see [`Self::check`].
#[derive(Clone, PartialEq)]
pub struct Profile {
    scheme: Scheme,
    angle_bits: AngleBits,
    limits: ExtractionLimits,
    vocabulary: Vocabulary,
}

impl Profile {
    /// With 12-bit angles and the default limits.
    pub fn new(scheme: Scheme, vocabulary: Vocabulary) -> Self {
        Self { scheme, angle_bits: AngleBits::default(), limits: ExtractionLimits::default(), vocabulary }
    }

    /// The same with another scheme.
    #[must_use]
    pub fn with_scheme(&self, scheme: Scheme) -> Self {
        Self { scheme, ..self.clone() }
    }

    /// The same with another number of bits per angle.
    #[must_use]
    pub fn with_angle_bits(&self, angle_bits: AngleBits) -> Self {
        Self { angle_bits, ..self.clone() }
    }

    /// The same with other limits.
    ///
    /// # Errors
    /// [`QueryError::Field`] for limits out of range.
    pub fn with_limits(&self, limits: ExtractionLimits) -> Result<Self, QueryError> {
        let ExtractionLimits { max_keypoints, max_image_side } = limits;
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
        Ok(Self { limits, ..self.clone() })
    }

    /// What is to happen to positions.
    pub const fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// Bits of an angle on the wire.
    pub const fn angle_bits(&self) -> AngleBits {
        self.angle_bits
    }

    /// How much to extract.
    pub const fn limits(&self) -> ExtractionLimits {
        self.limits
    }

    /// Which descriptors to extract.
    pub fn descriptor_kind(&self) -> DescriptorKind {
        self.vocabulary.kind()
    }

    /// What to make the global descriptor with.
    pub const fn vocabulary(&self) -> &Vocabulary {
        &self.vocabulary
    }

    /// The name of this profile: a hash of its bytes.
    pub fn id(&self) -> ProfileId {
        let hash = Sha256::digest(self.encode());
        let mut id = [0; 16];
        id.copy_from_slice(&hash[..16]);
        ProfileId(id)
    }

    /// Whether a query was sealed for a map with this profile: with the same vocabulary, descriptors and limits.
    /// Scheme and angle bits may differ, because the device chooses them.
    ///
    /// # Errors
    /// [`QueryError::WrongProfile`] when it was not.
    pub fn check(&self, query: &SealedQuery) -> Result<(), QueryError> {
        let asked = self.with_scheme(query.scheme()).with_angle_bits(query.angle_bits()).id();
        if asked == query.profile_id() {
            return Ok(());
        }
        Err(QueryError::WrongProfile { query: query.profile_id(), map: asked })
    }

    /// As bytes: one `veiloc.v1.Profile` message. Equal profiles have equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        let (scheme, angle, distance) = self.scheme.codes();
        let message = ProfileMessage {
            version: Some(VERSION),
            scheme: Some(scheme),
            dividing_angle: Some(angle),
            anchor_distance: Some(distance),
            angle_bits: Some(self.angle_bits.get().into()),
            descriptor_kind: Some(self.descriptor_kind().v1_code().unwrap_or_default()),
            max_keypoints: Some(self.limits.max_keypoints),
            max_image_side: Some(self.limits.max_image_side),
            vocabulary: Some(self.vocabulary.words().as_bytes().to_vec()),
        };
        message.encode_to_vec()
    }

    /// From bytes; whatever is accepted encodes to the same bytes again.
    ///
    /// # Errors
    /// [`QueryError`] saying which field is wrong.
    pub fn decode(bytes: &[u8]) -> Result<Self, QueryError> {
        let message: ProfileMessage = parse("profile", bytes, MAX_BYTES, |m: &ProfileMessage| m.version)?;
        let scheme = Scheme::from_codes(
            present("scheme", message.scheme)?,
            present("dividing_angle", message.dividing_angle)?,
            present("anchor_distance", message.anchor_distance)?,
        )?;
        let angle_bits = AngleBits::from_wire(present("angle_bits", message.angle_bits)?)?;
        let kind = descriptor_kind(present("descriptor_kind", message.descriptor_kind)?)?;
        let limits = ExtractionLimits {
            max_keypoints: present("max_keypoints", message.max_keypoints)?,
            max_image_side: present("max_image_side", message.max_image_side)?,
        };
        let vocabulary = Descriptors::new(kind, present("vocabulary", message.vocabulary)?)
            .and_then(Vocabulary::new)
            .map_err(|e| QueryError::Descriptor { what: "vocabulary", reason: e.to_string() })?;
        let profile = Self::new(scheme, vocabulary).with_angle_bits(angle_bits).with_limits(limits)?;
        if profile.encode() != bytes {
            return Err(QueryError::NotCanonical { what: "profile" });
        }
        Ok(profile)
    }
}

impl fmt::Debug for Profile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Profile({}, {}, {:?})", self.id(), self.scheme, self.limits)
    }
}

pub(crate) fn descriptor_kind(code: u32) -> Result<DescriptorKind, QueryError> {
    DescriptorKind::from_v1_code(code).ok_or(QueryError::Field {
        field: "descriptor_kind",
        value: code,
        allowed: "1 (RootSIFT)",
    })
}

/// The name of a profile: the first 16 bytes of the SHA-256 of its encoding. Printed as 32 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ProfileId([u8; 16]);

impl ProfileId {
    /// From its bytes.
    pub const fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }

    /// Its bytes.
    pub const fn as_bytes(&self) -> &[u8; 16] {
        &self.0
    }
}

impl fmt::Display for ProfileId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for ProfileId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ProfileId({self})")
    }
}
