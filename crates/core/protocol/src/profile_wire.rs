//! Profiles as bytes. The encoding is canonical: equal profiles have equal bytes, and no other bytes are accepted.

use prost::Message;
use veiloc_descriptor::{DescriptorKind, Descriptors, GlobalModel, NamedGlobal, Vocabulary};

use crate::wire::{Format, KindFields, ProfileMessage, present, refused};
use crate::{ExtractionLimits, Profile, QueryError};

const FORMAT: Format = Format {
    what: "profile",
    // The largest vocabulary and the fields around it.
    limit: GlobalModel::MAX_LEN + 4096,
    version: Profile::VERSION,
    remedy: "fetch the profile again; if its version stays the same, update the app or the service, \
             whichever is older",
};

impl Profile {
    /// The version of the message.
    pub const VERSION: u32 = 1;

    /// As bytes: one `veiloc.v1.Profile` message.
    pub fn encode(&self) -> Vec<u8> {
        let kind = KindFields::of(self.kind);
        let words = self.vocabulary().map(|vocabulary| vocabulary.words().as_bytes().to_vec());
        let message = ProfileMessage {
            version: Some(Self::VERSION),
            descriptor_name: Some(kind.name),
            descriptor_dim: Some(kind.dim),
            descriptor_encoding: Some(kind.encoding),
            descriptor_norm: Some(kind.norm),
            max_keypoints: Some(self.limits.max_keypoints),
            max_image_side: Some(self.limits.max_image_side),
            global_name: Some(self.global.name().to_owned()),
            global_codes: Some(self.global.global_len() as u32),
            vocabulary: Some(words.unwrap_or_default()),
        };
        message.encode_to_vec()
    }

    /// From bytes; an accepted message encodes to the same bytes again.
    ///
    /// # Errors
    /// [`QueryError`] naming the wrong field.
    pub fn decode(bytes: &[u8]) -> Result<Self, QueryError> {
        let profile = read(FORMAT.message(bytes)?)?;
        if profile.encode() != bytes {
            return Err(QueryError::NotCanonical { what: FORMAT.what });
        }
        Ok(profile)
    }
}

fn read(message: ProfileMessage) -> Result<Profile, QueryError> {
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
        // Surplus words are detected because encoding the profile again gives other bytes.
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
