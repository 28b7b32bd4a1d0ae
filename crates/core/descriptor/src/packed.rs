//! Descriptors in messages: numbers of 4 bits two per byte, others unchanged.

use crate::encoding::coarse;
use crate::{DescriptorError, DescriptorKind, Descriptors, Encoding};

impl Descriptors {
    /// `[N, packed_len]`, row by row; the first of two numbers in a byte is in the lower half. Values between the steps
    /// of [`Encoding::Coarse`] are reduced to their step.
    pub fn packed(&self) -> Vec<u8> {
        match self.kind().encoding() {
            Encoding::Unsigned | Encoding::Signed => self.as_bytes().to_vec(),
            Encoding::Coarse => {
                self.as_bytes().chunks_exact(2).map(|pair| pair[0] >> 4 | pair[1] & 0xf0).collect()
            }
        }
    }

    /// The descriptors as a reader of the message has them.
    #[must_use]
    pub fn as_decoded(self) -> Self {
        match self.kind().encoding() {
            Encoding::Unsigned | Encoding::Signed => self,
            Encoding::Coarse => Self::from_packed(self.kind(), &self.packed()).expect("whole rows"),
        }
    }

    /// From the output of [`Self::packed`].
    ///
    /// # Errors
    /// [`DescriptorError::Length`] when the bytes are not whole rows.
    pub fn from_packed(kind: DescriptorKind, bytes: &[u8]) -> Result<Self, DescriptorError> {
        let len = kind.packed_len();
        if !bytes.len().is_multiple_of(len) {
            return Err(DescriptorError::Length { bytes: bytes.len(), dim: len });
        }
        match kind.encoding() {
            Encoding::Unsigned | Encoding::Signed => Self::new(kind, bytes.to_vec()),
            Encoding::Coarse => {
                Self::new(kind, bytes.iter().flat_map(|b| [coarse(b & 15), coarse(b >> 4)]).collect())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn two_numbers_share_a_byte() {
        let kind = DescriptorKind::COMPACT;
        assert_eq!((kind.dim(), kind.packed_len()), (64, 32));
        let bytes: Vec<u8> = (0..64).map(|i| coarse(i % 16)).collect();
        let rows = Descriptors::new(kind, bytes).expect("a row");
        assert_eq!(rows.packed()[..3], [0x10, 0x32, 0x54]);
        assert_eq!(Descriptors::from_packed(kind, &rows.packed()), Ok(rows.clone()));
        let between =
            Descriptors::new(kind, (0..64).map(|i| coarse(i % 16) + i % 7).collect()).expect("a row");
        assert_eq!(between.as_decoded(), rows);
        let short = Descriptors::from_packed(kind, &[0; 33]);
        assert_eq!(short, Err(DescriptorError::Length { bytes: 33, dim: 32 }));
        let odd = DescriptorKind::new("own", 5, Encoding::Coarse, 100);
        assert!(matches!(odd, Err(DescriptorError::Kind { field: "dim", value: 5, .. })), "{odd:?}");
    }

    proptest! {
        #[test]
        fn messages_are_canonical(bytes in proptest::collection::vec(any::<u8>(), 32 * 3)) {
            for kind in [DescriptorKind::COMPACT, DescriptorKind::new("own", 32, Encoding::Signed, 99).expect("a kind")] {
                let rows = Descriptors::from_packed(kind, &bytes).expect("whole rows");
                prop_assert_eq!(rows.packed(), &bytes[..]);
            }
        }
    }
}
