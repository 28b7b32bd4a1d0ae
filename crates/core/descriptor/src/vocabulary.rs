//! VLAD: sums of the differences between the descriptors of an image and the nearest of a few fixed words.

use rand::Rng;
use veiloc_simd::PackedRows;

use crate::{
    DescriptorError, DescriptorKind, DescriptorView, Descriptors, GlobalDescriptor, kmeans,
    neighbours::{nearest_rows, pack},
};

/// The words of a visual vocabulary, `[K, dim]` bytes, and the aggregation of an image's descriptors over them.
///
/// # Method
/// VLAD (Jégou et al., *Aggregating local descriptors into a compact image representation*, CVPR 2010) with
/// intra-normalization (Arandjelović and Zisserman, *All about VLAD*, CVPR 2013), which replaces the signed square root
/// and is better: a single word with many repetitive descriptors does not dominate the others.
///
/// ```text
/// V_k = sum of (x - c_k) over the descriptors x whose nearest word is c_k     exact, in integers
/// v_k = V_k / |V_k|, or 0
/// codes = round(127 v)                                                        [K * dim]
/// ```
///
/// Each `v_k` is a unit vector, so no component is above 1 and no code saturates. The usual last step, division of the
/// whole vector by its length, is left out: the cosine does not depend on a common factor, and after the division codes
/// would be only one or two. The error of a code is at most one half, of `v` at most 1/254 per component; the error of
/// the cosine is below 0.002 in the tests.
#[derive(Clone)]
pub struct Vocabulary {
    words: Descriptors,
    packed: PackedRows,
}

impl std::fmt::Debug for Vocabulary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Vocabulary({:?}, {})", self.kind(), self.len())
    }
}

impl PartialEq for Vocabulary {
    fn eq(&self, other: &Self) -> bool {
        self.words == other.words
    }
}

impl Eq for Vocabulary {}

impl Vocabulary {
    /// Maximum number of words of a vocabulary: a global descriptor of 1 MiB for RootSIFT, 4 MiB at most.
    pub const MAX_LEN: usize = 8192;

    /// From its words.
    ///
    /// # Errors
    /// [`DescriptorError::WordCount`] when there are none, or more than [`Vocabulary::MAX_LEN`].
    pub fn new(words: Descriptors) -> Result<Self, DescriptorError> {
        check_word_count(words.len())?;
        let packed = pack(words.view());
        Ok(Self { words, packed })
    }

    /// Trains `k` words on descriptors of many images by k-means.
    ///
    /// Equal samples and an equal generator give equal words, on every machine and for any number of threads. 1000
    /// samples per word are sufficient; the time is proportional to `samples * k`.
    ///
    /// # Errors
    /// - [`DescriptorError::WordCount`] when `k` is 0 or more than [`Vocabulary::MAX_LEN`].
    /// - [`DescriptorError::TooFewSamples`] for fewer than `k` distinct samples.
    pub fn train(samples: DescriptorView<'_>, k: usize, rng: &mut impl Rng) -> Result<Self, DescriptorError> {
        check_word_count(k)?;
        let words = kmeans::train(samples, k, rng)?;
        Self::new(Descriptors::new(samples.kind(), words)?)
    }

    /// Kind of its descriptors.
    pub const fn kind(&self) -> DescriptorKind {
        self.words.kind()
    }

    /// Number of words, K.
    pub const fn len(&self) -> usize {
        self.words.len()
    }

    /// Always false: a vocabulary has at least one word.
    pub const fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    /// Its words, `[K, dim]`.
    pub fn words(&self) -> DescriptorView<'_> {
        self.words.view()
    }

    /// Number of codes of its global descriptors, `K * dim`.
    pub const fn global_len(&self) -> usize {
        self.len() * self.kind().dim()
    }

    /// Aggregates the descriptors of one image. Without descriptors, or for another kind, all zeros.
    ///
    /// The order of the descriptors does not matter.
    pub fn aggregate(&self, descriptors: DescriptorView<'_>) -> GlobalDescriptor {
        let dim = self.kind().dim();
        let residuals = self.residuals(descriptors);
        let codes = residuals.chunks_exact(dim).flat_map(|residual| {
            let length = residual.iter().map(|&r| (r as f64).powi(2)).sum::<f64>().sqrt();
            let scale = if length > 0.0 { f64::from(i8::MAX) / length } else { 0.0 };
            residual.iter().map(move |&r| (r as f64 * scale).round() as i8)
        });
        GlobalDescriptor::new(codes.collect())
    }

    /// `V_k` in the documentation of the type, `[K, dim]`.
    fn residuals(&self, descriptors: DescriptorView<'_>) -> Vec<i64> {
        let dim = self.kind().dim();
        let mut residuals = vec![0_i64; self.global_len()];
        if descriptors.kind() != self.kind() {
            return residuals;
        }
        let nearest = nearest_rows(descriptors.as_bytes(), &self.packed);
        for (row, two) in descriptors.as_bytes().chunks_exact(dim).zip(nearest) {
            let word = two.expect("a vocabulary has at least one word").nearest.index as usize;
            let residual = &mut residuals[word * dim..][..dim];
            for ((sum, &value), &center) in residual.iter_mut().zip(row).zip(self.words.row(word)) {
                *sum += i64::from(value) - i64::from(center);
            }
        }
        residuals
    }

    /// Its bytes, for a file: the magic bytes `VLAD`, then as little-endian `u32` the version, 1, and K, then the kind
    /// `[40]` (see [`DescriptorKind::to_bytes`]), then the words `[K, dim]`.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([VERSION, self.len() as u32].into_iter().flat_map(u32::to_le_bytes));
        bytes.extend(self.kind().to_bytes());
        bytes.extend_from_slice(self.words.as_bytes());
        bytes
    }

    /// Reads the output of [`Vocabulary::to_bytes`], and nothing else.
    ///
    /// # Errors
    /// [`DescriptorError`] for wrong magic bytes, version, kind, number of words or length.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DescriptorError> {
        if !bytes.iter().zip(MAGIC).all(|(a, b)| a == b) {
            return Err(DescriptorError::NotAVocabulary);
        }
        let too_short = |expected| DescriptorError::VocabularyLength { expected, found: bytes.len() };
        let cut = || too_short(HEADER + DescriptorKind::BYTES);
        let rest = bytes.get(MAGIC.len()..).ok_or_else(cut)?;
        let (version, rest) = rest.split_first_chunk().ok_or_else(cut)?;
        let found = u32::from_le_bytes(*version);
        if found != VERSION {
            return Err(DescriptorError::VocabularyVersion { found, supported: VERSION });
        }
        let (count, rest) = rest.split_first_chunk().ok_or_else(cut)?;
        let (kind, words) = rest.split_first_chunk::<{ DescriptorKind::BYTES }>().ok_or_else(cut)?;
        let kind = DescriptorKind::from_bytes(kind)?;
        let count = u32::from_le_bytes(*count) as usize;
        check_word_count(count)?;
        if words.len() != count * kind.dim() {
            return Err(too_short(bytes.len() - words.len() + count * kind.dim()));
        }
        Self::new(Descriptors::new(kind, words.to_vec())?)
    }
}

fn check_word_count(words: usize) -> Result<(), DescriptorError> {
    if (1..=Vocabulary::MAX_LEN).contains(&words) {
        return Ok(());
    }
    Err(DescriptorError::WordCount { words, max: Vocabulary::MAX_LEN })
}

pub(crate) const MAGIC: &[u8; 4] = b"VLAD";
const VERSION: u32 = 1;
/// Magic bytes, version and K.
const HEADER: usize = 12;

#[cfg(test)]
mod tests;
