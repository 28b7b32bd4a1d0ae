//! Profiles as bytes, in both versions. Equal profiles have equal bytes, and nothing else is read.

use prost::Message;
use veiloc_descriptor::{DescriptorKind, Descriptors, GlobalModel, NamedGlobal, Vocabulary};

use crate::profile::{Form, Wish};
use crate::wire::{KindFields, ProfileMessage, ProfileMessageV2, message, present, refused, version_of};
use crate::{AngleBits, ExtractionLimits, Profile, QueryError, Scheme, WireVersion};

/// Most bytes a profile may have: the largest vocabulary and the fields around it.
const MAX_BYTES: usize = GlobalModel::MAX_LEN + 4096;
const WHAT: &str = "profile";

impl Profile {
    /// As bytes: one `veiloc.v1.Profile` or `veiloc.v2.Profile` message, in the version it was made in.
    pub fn encode(&self) -> Vec<u8> {
        self.encode_as(self.form).expect("what was made in version 1 can be said in version 1")
    }

    /// `None` when that version cannot say it.
    pub(crate) fn encode_as(&self, form: Form) -> Option<Vec<u8>> {
        let words = self.vocabulary().map(|vocabulary| vocabulary.words().as_bytes().to_vec());
        let (max_keypoints, max_image_side) =
            (Some(self.limits.max_keypoints), Some(self.limits.max_image_side));
        match form {
            Form::V1(Wish { scheme, angle_bits }) => {
                let (scheme, angle, distance) = scheme.codes();
                let message = ProfileMessage {
                    version: Some(WireVersion::V1.number()),
                    scheme: Some(scheme),
                    dividing_angle: Some(angle),
                    anchor_distance: Some(distance),
                    angle_bits: Some(angle_bits.get().into()),
                    descriptor_kind: Some(self.kind.v1_code()?),
                    max_keypoints,
                    max_image_side,
                    vocabulary: Some(words?),
                };
                Some(message.encode_to_vec())
            }
            Form::V2 => {
                let kind = KindFields::of(self.kind);
                let message = ProfileMessageV2 {
                    version: Some(WireVersion::V2.number()),
                    descriptor_name: Some(kind.name),
                    descriptor_dim: Some(kind.dim),
                    descriptor_encoding: Some(kind.encoding),
                    descriptor_norm: Some(kind.norm),
                    max_keypoints,
                    max_image_side,
                    global_name: Some(self.global.name().to_owned()),
                    global_codes: Some(self.global.global_len() as u32),
                    vocabulary: Some(words.unwrap_or_default()),
                };
                Some(message.encode_to_vec())
            }
        }
    }

    /// From bytes of either version; whatever is accepted encodes to the same bytes again.
    ///
    /// # Errors
    /// [`QueryError`] saying which field is wrong.
    pub fn decode(bytes: &[u8]) -> Result<Self, QueryError> {
        let profile = match version_of(WHAT, bytes, MAX_BYTES, &WireVersion::OF_PROFILES)? {
            WireVersion::V1 => version_1(message(WHAT, bytes)?)?,
            WireVersion::V2 | WireVersion::V3 | WireVersion::V4 => version_2(message(WHAT, bytes)?)?,
        };
        if profile.encode() != bytes {
            return Err(QueryError::NotCanonical { what: WHAT });
        }
        Ok(profile)
    }
}

fn version_1(message: ProfileMessage) -> Result<Profile, QueryError> {
    let scheme = Scheme::from_codes(
        present("scheme", message.scheme)?,
        present("dividing_angle", message.dividing_angle)?,
        present("anchor_distance", message.anchor_distance)?,
    )?;
    let angle_bits = AngleBits::from_wire(present("angle_bits", message.angle_bits)?)?;
    let kind = kind_of_version_1(present("descriptor_kind", message.descriptor_kind)?)?;
    let limits = limits(message.max_keypoints, message.max_image_side)?;
    let vocabulary = vocabulary(kind, present("vocabulary", message.vocabulary)?)?;
    let profile = Profile::vlad(vocabulary).with_limits(limits)?;
    Ok(Profile { form: Form::V1(Wish { scheme, angle_bits }), ..profile })
}

fn version_2(message: ProfileMessageV2) -> Result<Profile, QueryError> {
    let kind = KindFields {
        name: present("descriptor_name", message.descriptor_name)?,
        dim: present("descriptor_dim", message.descriptor_dim)?,
        encoding: present("descriptor_encoding", message.descriptor_encoding)?,
        norm: present("descriptor_norm", message.descriptor_norm)?,
    }
    .kind()?;
    let limits = limits(message.max_keypoints, message.max_image_side)?;
    let name = present("global_name", message.global_name)?;
    let codes = present("global_codes", message.global_codes)?;
    let words = present("vocabulary", message.vocabulary)?;
    let global = if name == GlobalModel::VLAD {
        GlobalModel::Vlad(vocabulary(kind, words)?)
    } else {
        // Words that belong to no vocabulary are found by writing the profile again.
        GlobalModel::Named(NamedGlobal::new(&name, codes as usize).map_err(|e| refused("global_name", &e))?)
    };
    Profile::new(kind, global)?.with_limits(limits)
}

fn limits(max_keypoints: Option<u32>, max_image_side: Option<u32>) -> Result<ExtractionLimits, QueryError> {
    Ok(ExtractionLimits {
        max_keypoints: present("max_keypoints", max_keypoints)?,
        max_image_side: present("max_image_side", max_image_side)?,
    })
}

fn vocabulary(kind: DescriptorKind, words: Vec<u8>) -> Result<Vocabulary, QueryError> {
    Descriptors::new(kind, words).and_then(Vocabulary::new).map_err(|e| refused("vocabulary", &e))
}

pub(crate) fn kind_of_version_1(code: u32) -> Result<DescriptorKind, QueryError> {
    DescriptorKind::from_v1_code(code).ok_or(QueryError::Field {
        field: "descriptor_kind",
        value: code,
        allowed: "1 (RootSIFT)",
    })
}
