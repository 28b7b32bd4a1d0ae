//! How the global descriptor of an image is computed.

use crate::{DescriptorError, DescriptorView, GlobalDescriptor, Name, Vocabulary, vocabulary};

/// The source of the global descriptors of a map and its queries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum GlobalModel {
    /// Aggregated from the rows that are sent, so that it contains no further information.
    Vlad(Vocabulary),
    /// Computed from the image by an extractor that both sides know by name.
    Named(NamedGlobal),
}

/// A global descriptor of an extractor: a unit vector times 127, rounded to `i8`, `[dim]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct NamedGlobal {
    name: Name,
    dim: u32,
}

impl NamedGlobal {
    /// Largest number of components.
    pub const MAX_DIM: usize = 16_384;
    const BYTES: usize = 4 + 4 + Name::BYTES;

    /// The model of this name with `dim` components.
    ///
    /// # Errors
    /// [`DescriptorError::Name`], or [`DescriptorError::Kind`] for a dimension other than 1 to [`Self::MAX_DIM`].
    pub fn new(name: &str, dim: usize) -> Result<Self, DescriptorError> {
        Self::from_parts(Name::new(name)?, dim as u64)
    }

    fn from_parts(name: Name, dim: u64) -> Result<Self, DescriptorError> {
        if !(1..=Self::MAX_DIM as u64).contains(&dim) {
            return Err(DescriptorError::Kind { field: "global dim", value: dim, allowed: "1 to 16384" });
        }
        if name.as_str() == GlobalModel::VLAD {
            return Err(DescriptorError::NameTaken { name: name.as_str().to_owned() });
        }
        Ok(Self { name, dim: dim as u32 })
    }

    /// Its name.
    pub fn name(&self) -> &str {
        self.name.as_str()
    }

    /// Number of components.
    pub const fn dim(&self) -> usize {
        self.dim as usize
    }
}

impl GlobalModel {
    /// Maximum number of codes of any model's descriptors.
    pub const MAX_LEN: usize = Vocabulary::MAX_LEN * crate::DescriptorKind::MAX_DIM;

    /// The name of aggregation with a vocabulary.
    pub const VLAD: &str = "vlad";

    /// Number of codes of its descriptors.
    pub const fn global_len(&self) -> usize {
        match self {
            Self::Vlad(vocabulary) => vocabulary.global_len(),
            Self::Named(named) => named.dim(),
        }
    }

    /// The name in messages and reports.
    pub fn name(&self) -> &str {
        match self {
            Self::Vlad(_) => Self::VLAD,
            Self::Named(named) => named.name(),
        }
    }

    /// The vocabulary, if descriptors are aggregated with one.
    pub const fn vocabulary(&self) -> Option<&Vocabulary> {
        match self {
            Self::Vlad(vocabulary) => Some(vocabulary),
            Self::Named(_) => None,
        }
    }

    /// The global descriptor computed from an image's rows alone; `None` for models that need the image.
    pub fn of_rows(&self, rows: DescriptorView<'_>) -> Option<GlobalDescriptor> {
        self.vocabulary().map(|vocabulary| vocabulary.aggregate(rows))
    }

    /// For files and messages: a vocabulary as [`Vocabulary::to_bytes`] writes it; otherwise the magic bytes `GLOB`,
    /// dim as little-endian `u32`, and the name `[32]`.
    pub fn to_bytes(&self) -> Vec<u8> {
        match self {
            Self::Vlad(vocabulary) => vocabulary.to_bytes(),
            Self::Named(named) => {
                let mut bytes = NAMED_MAGIC.to_vec();
                bytes.extend(named.dim.to_le_bytes());
                bytes.extend(named.name.to_bytes());
                bytes
            }
        }
    }

    /// Reads the output of [`Self::to_bytes`], and nothing else.
    ///
    /// # Errors
    /// [`DescriptorError`] for invalid bytes.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DescriptorError> {
        match bytes.first_chunk() {
            Some(vocabulary::MAGIC) => Vocabulary::from_bytes(bytes).map(Self::Vlad),
            Some(NAMED_MAGIC) => {
                let expected = NamedGlobal::BYTES;
                let length = DescriptorError::GlobalModelLength { expected, found: bytes.len() };
                let Ok(bytes) = <&[u8; NamedGlobal::BYTES]>::try_from(bytes) else { return Err(length) };
                let dim = u32::from_le_bytes([bytes[4], bytes[5], bytes[6], bytes[7]]);
                let name = bytes.last_chunk().ok_or(length)?;
                NamedGlobal::from_parts(Name::from_bytes(name)?, dim.into()).map(Self::Named)
            }
            _ => Err(DescriptorError::NotAGlobalModel),
        }
    }
}

impl From<Vocabulary> for GlobalModel {
    fn from(vocabulary: Vocabulary) -> Self {
        Self::Vlad(vocabulary)
    }
}

const NAMED_MAGIC: &[u8; 4] = b"GLOB";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::random_descriptors;

    #[test]
    fn both_kinds_round_trip_with_their_lengths() {
        let vlad = GlobalModel::Vlad(Vocabulary::new(random_descriptors(4, 1)).expect("words"));
        let named = GlobalModel::Named(NamedGlobal::new("netvlad", 4096).expect("a model"));
        for (model, len) in [(&vlad, 4 * 128), (&named, 4096)] {
            assert_eq!(GlobalModel::from_bytes(&model.to_bytes()).as_ref(), Ok(model));
            assert_eq!(model.global_len(), len);
        }
        let rows = random_descriptors(9, 2);
        assert_eq!(vlad.of_rows(rows.view()).map(|g| g.len()), Some(512));
        assert_eq!(named.of_rows(rows.view()), None);
    }

    #[test]
    fn other_bytes_are_rejected() {
        let good = GlobalModel::Named(NamedGlobal::new("netvlad", 4096).expect("a model")).to_bytes();
        assert_eq!(GlobalModel::from_bytes(b"abc"), Err(DescriptorError::NotAGlobalModel));
        assert_eq!(GlobalModel::from_bytes(b"ABCDE"), Err(DescriptorError::NotAGlobalModel));
        let cut = GlobalModel::from_bytes(&good[..30]);
        assert_eq!(cut, Err(DescriptorError::GlobalModelLength { expected: 40, found: 30 }));
        let mut bytes = good.clone();
        bytes[7] = 1;
        assert!(matches!(GlobalModel::from_bytes(&bytes), Err(DescriptorError::Kind { .. })));
        bytes = good;
        bytes[39] = 1;
        assert_eq!(GlobalModel::from_bytes(&bytes), Err(DescriptorError::Name));
        assert!(matches!(NamedGlobal::new("vlad", 64), Err(DescriptorError::NameTaken { .. })));
        assert!(NamedGlobal::new("netvlad", 0).is_err() && NamedGlobal::new("netvlad", 16_385).is_err());
    }
}
