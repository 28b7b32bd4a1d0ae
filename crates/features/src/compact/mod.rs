//! Compact descriptors: RootSIFT projected to 64 numbers of 4 bits.
//!
//! A quarter of the bytes, and nearest neighbours that are right as often or oftener (`docs/features.md`): the projection
//! keeps the directions in which descriptors of different places differ most, measured in how much those of one place
//! differ (linear discriminant analysis). `scripts/train_compact.py` made it, from warped images of elsewhere.
//!
//! Integers throughout: equal descriptors give equal bytes on every machine.

use veiloc_descriptor::{DescriptorKind, Descriptors};

use crate::{Extractor, FeatureError, Features, Image, Sift};

const FROM: usize = DescriptorKind::ROOT_SIFT.dim();
const TO: usize = DescriptorKind::COMPACT.dim();
/// A step of a projected number, in parts of the products' unit, as a power of two.
const SHIFT: u32 = 18;
/// `[TO, FROM]` weights, little endian i16, then `[TO]` offsets, i32.
const PROJECTION: &[u8; TO * (2 * FROM + 4)] = include_bytes!("projection.bin");

/// SIFT keypoints with compact descriptors.
#[derive(Debug, Clone, Default)]
pub struct Compact {
    /// What finds the keypoints and describes them at first.
    pub sift: Sift,
}

impl Compact {
    /// As a device describes what it sends: the image's border does not show ([`Sift::for_sealing`]).
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

    fn reach(&self) -> f64 {
        self.sift.reach()
    }

    fn sight(&self) -> f64 {
        self.sift.sight()
    }
}

/// RootSIFT descriptors projected, row by row.
///
/// # Panics
/// When they are of another kind.
pub fn compact(sift: &Descriptors) -> Descriptors {
    assert_eq!(sift.kind(), DescriptorKind::ROOT_SIFT, "what is projected is RootSIFT");
    let (weights, offsets) = PROJECTION.split_at(2 * TO * FROM);
    let weights: Vec<i32> =
        weights.as_chunks().0.iter().map(|bytes| i16::from_le_bytes(*bytes).into()).collect();
    let offsets: Vec<i32> = offsets.as_chunks().0.iter().map(|bytes| i32::from_le_bytes(*bytes)).collect();
    let mut rows = Vec::with_capacity(sift.len() * TO);
    for row in sift.as_bytes().chunks_exact(FROM) {
        let numbers: [i32; FROM] = std::array::from_fn(|j| row[j].into());
        for (weights, offset) in weights.chunks_exact(FROM).zip(&offsets) {
            let sum: i32 = weights.iter().zip(&numbers).map(|(w, x)| w * x).sum();
            let step = ((sum + offset) >> SHIFT).clamp(-8, 7) + 8;
            // The middle of the step, as `Encoding::Coarse` keeps it.
            rows.push((step << 4 | 8) as u8);
        }
    }
    Descriptors::new(DescriptorKind::COMPACT, rows).expect("whole rows")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// No sum can overflow, whatever the descriptor.
    #[test]
    fn the_largest_sum_fits() {
        let (weights, offsets) = PROJECTION.split_at(2 * TO * FROM);
        let weights: Vec<i64> =
            weights.as_chunks().0.iter().map(|bytes| i16::from_le_bytes(*bytes).into()).collect();
        let offsets = offsets.as_chunks().0.iter().map(|bytes| i64::from(i32::from_le_bytes(*bytes)));
        for (row, offset) in weights.chunks_exact(FROM).zip(offsets) {
            let most: i64 = row.iter().map(|w| w.abs() * 255).sum::<i64>() + offset.abs();
            assert!(most < i64::from(i32::MAX), "{most}");
        }
    }

    /// Against the same in floating point: every number is within its step.
    #[test]
    fn numbers_are_those_of_the_matrix() {
        let rows: Vec<u8> = (0..FROM * 50).map(|i| ((i * 7919 + i / 13) % 97) as u8).collect();
        let sift = Descriptors::new(DescriptorKind::ROOT_SIFT, rows).expect("whole rows");
        let found = compact(&sift);
        let (weights, offsets) = PROJECTION.split_at(2 * TO * FROM);
        for i in 0..sift.len() {
            for (k, byte) in found.row(i).iter().enumerate() {
                let weight = |j: usize| {
                    let at = 2 * (k * FROM + j);
                    f64::from(i16::from_le_bytes([weights[at], weights[at + 1]]))
                };
                let offset = i32::from_le_bytes(offsets[4 * k..4 * k + 4].try_into().expect("four"));
                let sum: f64 = (0..FROM).map(|j| weight(j) * f64::from(sift.row(i)[j])).sum();
                let steps = ((sum + f64::from(offset)) / f64::from(1 << SHIFT)).clamp(-8.0, 7.999);
                let value = f64::from(DescriptorKind::COMPACT.encoding().value(*byte)) / 16.0;
                assert!((value - steps).abs() <= 0.5, "row {i}, number {k}: {value} {steps}");
            }
        }
    }
}
