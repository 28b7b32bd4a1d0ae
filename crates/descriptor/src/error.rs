//! What can be wrong with descriptors and vocabularies.

/// Why descriptors, or a vocabulary, were refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptorError {
    /// The bytes are not a whole number of descriptors.
    #[error("{bytes} bytes are not a whole number of descriptors of {dim} bytes")]
    Length {
        /// How many bytes there were.
        bytes: usize,
        /// Bytes of one descriptor.
        dim: usize,
    },
    /// A vocabulary of no words, or of more than is supported, was asked for or read.
    #[error("a vocabulary of {words} words; supported are 1 to {max}")]
    WordCount {
        /// How many words.
        words: usize,
        /// The most there may be.
        max: usize,
    },
    /// Fewer different samples than words: each word needs one of its own.
    #[error(
        "{distinct} different samples (of {samples}) cannot train {words} words; give more images or fewer words"
    )]
    TooFewSamples {
        /// How many samples there were.
        samples: usize,
        /// How many of them differ from each other.
        distinct: usize,
        /// How many words were asked for.
        words: usize,
    },
    /// The bytes do not begin like a vocabulary.
    #[error("not a vocabulary: the first bytes are not its mark")]
    NotAVocabulary,
    /// The vocabulary is of a version this program does not know.
    #[error("vocabulary version {found}; this program reads version {supported}")]
    VocabularyVersion {
        /// The version found.
        found: u32,
        /// The one that is read.
        supported: u32,
    },
    /// The vocabulary is for descriptors this program does not know.
    #[error("vocabulary for descriptors of unknown kind {code}")]
    UnknownKind {
        /// The kind's number.
        code: u32,
    },
    /// A vocabulary's bytes were cut short, or something follows them.
    #[error("a vocabulary of {expected} bytes was announced, {found} are there")]
    VocabularyLength {
        /// How long it should be by its header (or the header itself).
        expected: usize,
        /// How many bytes there were.
        found: usize,
    },
}
