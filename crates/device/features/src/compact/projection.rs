//! A projection of descriptors to a few numbers of 4 bits, in integer arithmetic.

use veiloc_descriptor::{DescriptorKind, Descriptors, Encoding};

/// Projects descriptors of one kind to a smaller kind.
///
/// Number `i` of a descriptor `x` becomes `(Σ w[i, j] x[j] + o[i]) >> shift`, clipped to -8 to 7, where `x[j]` is the
/// value of a byte. `study features projection` makes the weights. Integer arithmetic: equal descriptors give equal
/// bytes on every machine.
#[derive(Clone, PartialEq, Eq)]
pub struct Projection {
    from: DescriptorKind,
    to: DescriptorKind,
    shift: u32,
    /// `[to, from]`
    weights: Vec<i16>,
    /// `[to]`
    offsets: Vec<i32>,
}

impl std::fmt::Debug for Projection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Projection({:?} to {:?})", self.from, self.to)
    }
}

/// Why bytes are not a valid projection.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ProjectionError {
    /// The target kind does not have numbers of 4 bits.
    #[error("a projection gives numbers of 4 bits, but the kind {0} has other numbers")]
    Target(DescriptorKind),
    /// The shift is not valid for 32-bit sums.
    #[error("its shift is {0} and must be 1 to 30")]
    Shift(u32),
    /// The length does not match the weights and offsets of these kinds.
    #[error("it has {actual} bytes, but a projection of {from} numbers to {to} has {expected}")]
    Length {
        /// Actual number of bytes.
        actual: usize,
        /// Required number of bytes.
        expected: usize,
        /// Dimension before the projection.
        from: usize,
        /// Dimension after the projection.
        to: usize,
    },
    /// The sum for some descriptor would exceed 32 bits.
    #[error("its weights are too large: number {0} of a descriptor may overflow; make the shift smaller")]
    Overflow(usize),
}

impl Projection {
    /// Reads the output of `study features projection`: `[to, from]` weights, little endian `i16`, then `[to]` offsets,
    /// `i32`.
    ///
    /// - `shift`: the quantization step, as a power of two in units of the products.
    ///
    /// # Errors
    /// [`ProjectionError`]. The projection can be applied to any descriptor without overflow.
    pub fn new(
        from: DescriptorKind,
        to: DescriptorKind,
        shift: u32,
        bytes: &[u8],
    ) -> Result<Self, ProjectionError> {
        if to.encoding() != Encoding::Coarse {
            return Err(ProjectionError::Target(to));
        }
        if !(1..=30).contains(&shift) {
            return Err(ProjectionError::Shift(shift));
        }
        let expected = to.dim() * (2 * from.dim() + 4);
        if bytes.len() != expected {
            let (actual, from, to) = (bytes.len(), from.dim(), to.dim());
            return Err(ProjectionError::Length { actual, expected, from, to });
        }
        let (weights, offsets) = bytes.split_at(2 * to.dim() * from.dim());
        let weights: Vec<i16> =
            weights.as_chunks().0.iter().map(|bytes| i16::from_le_bytes(*bytes)).collect();
        let offsets: Vec<i32> =
            offsets.as_chunks().0.iter().map(|bytes| i32::from_le_bytes(*bytes)).collect();
        let largest = [0, 255].map(|byte| i64::from(from.encoding().value(byte)).abs()).into_iter().max();
        let largest = largest.unwrap_or_default();
        for (number, (row, offset)) in weights.chunks_exact(from.dim()).zip(&offsets).enumerate() {
            let most = row.iter().map(|w| i64::from(*w).abs() * largest).sum::<i64>();
            if most + i64::from(*offset).abs() > i64::from(i32::MAX) {
                return Err(ProjectionError::Overflow(number));
            }
        }
        Ok(Self { from, to, shift, weights, offsets })
    }

    /// The kind of the projected descriptors.
    pub fn to(&self) -> DescriptorKind {
        self.to
    }

    /// Projects descriptors, row by row.
    ///
    /// # Panics
    /// For descriptors of another kind than `from`.
    pub fn apply(&self, descriptors: &Descriptors) -> Descriptors {
        assert_eq!(descriptors.kind(), self.from, "the descriptors are of the projection's input kind");
        let encoding = self.from.encoding();
        let mut rows = Vec::with_capacity(descriptors.len() * self.to.dim());
        let mut numbers = vec![0; self.from.dim()];
        for row in descriptors.as_bytes().chunks_exact(self.from.dim()) {
            for (number, byte) in numbers.iter_mut().zip(row) {
                *number = encoding.value(*byte);
            }
            for (weights, offset) in self.weights.chunks_exact(self.from.dim()).zip(&self.offsets) {
                let sum: i32 = weights.iter().zip(&numbers).map(|(w, x)| i32::from(*w) * i32::from(*x)).sum();
                let step = ((sum + offset) >> self.shift).clamp(-8, 7) + 8;
                // The middle of the step, as in `Encoding::Coarse`.
                rows.push((step << 4 | 8) as u8);
            }
        }
        Descriptors::new(self.to, rows).expect("whole rows")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(name: &str, dim: usize, encoding: Encoding) -> DescriptorKind {
        DescriptorKind::new(name, dim, encoding, 100).expect("a kind")
    }

    fn file(weights: &[i16], offsets: &[i32]) -> Vec<u8> {
        let weights = weights.iter().flat_map(|w| w.to_le_bytes());
        weights.chain(offsets.iter().flat_map(|o| o.to_le_bytes())).collect()
    }

    /// Compared with floating point, for either encoding: every number is within its step.
    #[test]
    fn numbers_equal_the_matrix_product() {
        for encoding in [Encoding::Unsigned, Encoding::Signed] {
            let (from, to) = (kind("wide", 24, encoding), kind("small", 10, Encoding::Coarse));
            let weights: Vec<i16> = (0..240).map(|i| ((i * 7919 + i / 7) % 401 - 200) as i16).collect();
            let offsets: Vec<i32> = (0..10).map(|i| (i - 5) * 3000).collect();
            let projection = Projection::new(from, to, 14, &file(&weights, &offsets)).expect("a projection");
            let rows: Vec<u8> = (0..24 * 60).map(|i| ((i * 104_729 + i / 11) % 251) as u8).collect();
            let descriptors = Descriptors::new(from, rows).expect("whole rows");
            let found = projection.apply(&descriptors);
            assert_eq!((found.kind(), found.len()), (to, 60));
            let mut cut = 0;
            for i in 0..60 {
                for (k, byte) in found.row(i).iter().enumerate() {
                    let values = descriptors.row(i).iter().map(|byte| f64::from(encoding.value(*byte)));
                    let sum: f64 = values.zip(&weights[24 * k..]).map(|(x, w)| x * f64::from(*w)).sum();
                    let steps = (sum + f64::from(offsets[k])) / f64::from(1 << 14);
                    let value = f64::from(to.encoding().value(*byte)) / 16.0;
                    cut += usize::from(!(-8.0..8.0).contains(&steps));
                    let off = (value - steps.clamp(-8.0, 7.999)).abs();
                    assert!(off <= 0.5, "{encoding:?}, row {i}, number {k}: {value} {steps}");
                }
            }
            assert!((1..300).contains(&cut), "both clipped and unclipped values: {cut}");
        }
    }

    #[test]
    fn invalid_projection_is_rejected_with_its_fault() {
        let (from, to) = (kind("wide", 4, Encoding::Signed), kind("small", 2, Encoding::Coarse));
        let whole = file(&[1; 8], &[0; 2]);
        Projection::new(from, to, 16, &whole).expect("a projection");
        for wrong in [&whole[1..], &[&whole[..], &[0]].concat(), &[]] {
            let (actual, expected) = (wrong.len(), 24);
            let refused = ProjectionError::Length { actual, expected, from: 4, to: 2 };
            assert_eq!(Projection::new(from, to, 16, wrong), Err(refused));
        }
        assert_eq!(Projection::new(from, to, 0, &whole), Err(ProjectionError::Shift(0)));
        assert_eq!(Projection::new(from, to, 31, &whole), Err(ProjectionError::Shift(31)));
        assert_eq!(Projection::new(from, from, 16, &whole), Err(ProjectionError::Target(from)));
        // A signed byte has at least the value -128: the largest sum that fits, and one more.
        let offset = i32::MAX - 4 * 128 * 30_000;
        let most = |offset| file(&[1, 1, 1, 1, 30_000, -30_000, 30_000, -30_000], &[0, offset]);
        let largest = Projection::new(from, to, 16, &most(offset)).expect("it fits");
        assert_eq!(Projection::new(from, to, 16, &most(offset + 1)), Err(ProjectionError::Overflow(1)));
        let rows = Descriptors::new(from, vec![0, 255, 0, 255, 255, 0, 255, 0]).expect("whole rows");
        assert_eq!(largest.apply(&rows).as_bytes().len(), 4, "no overflow");
    }
}
