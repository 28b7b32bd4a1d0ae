//! Compact descriptors: RootSIFT projected to 64 numbers of 4 bits.
//!
//! A quarter of the bytes, with nearest neighbours that are right at least as often (`docs/results/features.md`). The
//! projection keeps the directions in which descriptors of different points differ most relative to the differences
//! within one point (linear discriminant analysis). `study features projection` trained it on warped out-of-map images.
//! [`Projection`] does the same for any other kind, such as those of networks.

mod projection;

use std::sync::LazyLock;

use veiloc_descriptor::{DescriptorKind, Descriptors};

pub use projection::{Projection, ProjectionError};

use crate::{Extractor, FeatureError, Features, Image, Sift};

static PROJECTION: LazyLock<Projection> = LazyLock::new(|| {
    let bytes = include_bytes!("projection.bin");
    Projection::new(DescriptorKind::ROOT_SIFT, DescriptorKind::COMPACT, 18, bytes).expect("a test reads it")
});

/// SIFT keypoints with compact descriptors.
#[derive(Debug, Clone, Default)]
pub struct Compact {
    /// Detects the keypoints and computes their RootSIFT descriptors.
    pub sift: Sift,
}

impl Compact {
    /// As a device describes features for sealing: the image's border does not show ([`Sift::for_sealing`]).
    pub fn for_sealing() -> Self {
        Self { sift: Sift::for_sealing() }
    }
}

impl Extractor for Compact {
    fn kind(&self) -> DescriptorKind {
        DescriptorKind::COMPACT
    }

    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError> {
        let Features { keypoints, descriptors, global } = self.sift.extract(image, max_keypoints)?;
        Ok(Features { keypoints, descriptors: compact(&descriptors), global })
    }

    fn support_radius(&self) -> f64 {
        self.sift.support_radius()
    }

    fn receptive_field(&self) -> f64 {
        self.sift.receptive_field()
    }
}

/// Projects RootSIFT descriptors, row by row.
///
/// # Panics
/// For descriptors of another kind.
pub fn compact(sift: &Descriptors) -> Descriptors {
    PROJECTION.apply(sift)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn built_in_projection_is_complete_and_never_overflows() {
        assert_eq!(PROJECTION.to(), DescriptorKind::COMPACT);
    }

    /// Earlier maps and queries must stay compatible: these bytes never change.
    #[test]
    fn rows_are_unchanged() {
        let rows: Vec<u8> = (0..128 * 50).map(|i| ((i * 7919 + i / 13) % 97) as u8).collect();
        let sift = Descriptors::new(DescriptorKind::ROOT_SIFT, rows).expect("whole rows");
        let found = compact(&sift);
        assert_eq!((found.kind(), found.len()), (DescriptorKind::COMPACT, 50));
        let sum = found.as_bytes().iter().fold(0xcbf2_9ce4_8422_2325_u64, |sum, byte| {
            (sum ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
        });
        assert_eq!(sum, 0x0a0f_76c8_cfcc_c7a5, "{:?}", found.row(0));
    }
}
