//! One vector for a whole image.

use veiloc_simd::dot_i8;

/// An image's descriptors aggregated into one vector, `[K * dim]` for a vocabulary of K words; see
/// [`Vocabulary::aggregate`](crate::Vocabulary::aggregate).
///
/// Only its direction is significant: images are compared by the cosine between their vectors.
#[derive(Clone, PartialEq, Eq)]
pub struct GlobalDescriptor {
    codes: Vec<i8>,
}

// It reveals the place in the image: only its length may be logged (leak L8).
impl std::fmt::Debug for GlobalDescriptor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "GlobalDescriptor({})", self.codes.len())
    }
}

impl GlobalDescriptor {
    /// From its codes, as read from a file or a message.
    pub const fn new(codes: Vec<i8>) -> Self {
        Self { codes }
    }

    /// Its codes, `[K * dim]`.
    pub fn as_codes(&self) -> &[i8] {
        &self.codes
    }

    /// Number of codes, `K * dim`.
    pub const fn len(&self) -> usize {
        self.codes.len()
    }

    /// True when there are no codes.
    pub const fn is_empty(&self) -> bool {
        self.codes.is_empty()
    }

    /// Cosine of the angle to another global descriptor, in \[-1, 1\].
    ///
    /// 0 when either is all zeros (an image without descriptors), or when the lengths differ: vectors of different
    /// vocabularies are not comparable.
    pub fn similarity(&self, codes: &[i8]) -> f32 {
        self.similarity_of_square(dot_i8(&self.codes, &self.codes), codes)
    }

    /// [`Self::similarity`] with its own squared length given.
    fn similarity_of_square(&self, square: i64, codes: &[i8]) -> f32 {
        if self.codes.len() != codes.len() {
            return 0.0;
        }
        let norms = (square as f64 * dot_i8(codes, codes) as f64).sqrt();
        if norms == 0.0 {
            return 0.0;
        }
        (dot_i8(&self.codes, codes) as f64 / norms).clamp(-1.0, 1.0) as f32
    }

    /// The `count` most similar of these images, each with its index and its codes: indices and [`Self::similarity`],
    /// the most similar first, of equal ones the smaller index first.
    pub fn most_similar<'a>(
        &self,
        images: impl IntoIterator<Item = (usize, &'a [i8])>,
        count: usize,
    ) -> Vec<(usize, f32)> {
        let square = dot_i8(&self.codes, &self.codes);
        let similarity = |(image, codes)| (image, self.similarity_of_square(square, codes));
        let mut all: Vec<(usize, f32)> = images.into_iter().map(similarity).collect();
        let better = |a: &(usize, f32), b: &(usize, f32)| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0));
        // Only the best must be sorted: for a city they are few.
        if (1..all.len()).contains(&count) {
            all.select_nth_unstable_by(count - 1, better);
        }
        all.truncate(count);
        all.sort_by(better);
        all
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn known_angles() {
        let x = GlobalDescriptor::new(vec![100, 0]);
        assert_eq!(x.similarity(&[3, 0]), 1.0);
        assert_eq!(x.similarity(&[-128, 0]), -1.0);
        assert_eq!(x.similarity(&[0, 7]), 0.0);
        assert!((x.similarity(&[1, 1]) - 0.5_f32.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn most_similar_first_and_ties_by_index() {
        let x = GlobalDescriptor::new(vec![100, 0]);
        let images: [&[i8]; 4] = [&[0, 1], &[5, 5], &[9, 0], &[1, 1]];
        let found = |count| {
            let all = x.most_similar(images.iter().copied().enumerate(), count);
            all.into_iter().map(|(image, _)| image).collect::<Vec<_>>()
        };
        assert_eq!(found(0), [0; 0]);
        assert_eq!(found(2), [2, 1]);
        assert_eq!(found(4), [2, 1, 3, 0]);
        assert_eq!(found(9), [2, 1, 3, 0]);
        assert_eq!(x.most_similar([(7, images[2])], 1), [(7, 1.0)]);
    }

    #[test]
    fn similarity_of_zeros_and_other_lengths_is_zero() {
        let x = GlobalDescriptor::new(vec![1, 2]);
        assert_eq!(x.similarity(&[0, 0]), 0.0);
        assert_eq!(x.similarity(&[1, 2, 3]), 0.0);
        assert_eq!(GlobalDescriptor::new(Vec::new()).similarity(&[]), 0.0);
    }

    #[test]
    fn debug_shows_no_codes() {
        assert_eq!(format!("{:?}", GlobalDescriptor::new(vec![42; 3])), "GlobalDescriptor(3)");
    }

    proptest! {
        #[test]
        fn symmetric_and_bounded(codes in prop::collection::vec(any::<(i8, i8)>(), 0..300)) {
            let (a, b): (Vec<_>, Vec<_>) = codes.into_iter().unzip();
            let forth = GlobalDescriptor::new(a.clone()).similarity(&b);
            prop_assert_eq!(forth, GlobalDescriptor::new(b).similarity(&a));
            prop_assert!((-1.0..=1.0).contains(&forth));
        }
    }
}
