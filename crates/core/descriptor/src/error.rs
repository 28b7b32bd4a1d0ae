//! Errors of descriptors and vocabularies.

/// Why descriptors or a vocabulary were rejected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptorError {
    /// The name is invalid.
    #[error("a name has 1 to 31 characters a-z, 0-9 and -, beginning with a letter")]
    Name,
    /// A number of a kind or of a global model is out of range.
    #[error("descriptor kind: {field} is {value}; allowed is {allowed}")]
    Kind {
        /// The number.
        field: &'static str,
        /// Its value.
        value: u64,
        /// The allowed values.
        allowed: &'static str,
    },
    /// A built-in kind has this name and other numbers.
    #[error("the name {name} is built in with other numbers; choose another name")]
    NameTaken {
        /// The name.
        name: String,
    },
    /// The bytes are not a global model: neither a vocabulary nor a named one.
    #[error("not a global model: unknown magic bytes")]
    NotAGlobalModel,
    /// Wrong length of a named global model.
    #[error("a named global model has {expected} bytes, but {found} were given")]
    GlobalModelLength {
        /// Its length.
        expected: usize,
        /// The given length.
        found: usize,
    },
    /// The bytes are not a whole number of descriptors.
    #[error("{bytes} bytes are not a whole number of descriptors of {dim} bytes")]
    Length {
        /// Number of bytes.
        bytes: usize,
        /// Bytes of one descriptor.
        dim: usize,
    },
    /// A vocabulary without words, or with more than supported.
    #[error("a vocabulary of {words} words; supported are 1 to {max}")]
    WordCount {
        /// Number of words.
        words: usize,
        /// Maximum number.
        max: usize,
    },
    /// Fewer distinct samples than words: each word needs its own sample.
    #[error(
        "{distinct} different samples (of {samples}) cannot train {words} words; give more images or fewer words"
    )]
    TooFewSamples {
        /// Number of samples.
        samples: usize,
        /// Number of distinct samples.
        distinct: usize,
        /// Requested number of words.
        words: usize,
    },
    /// The bytes do not start with the magic bytes of a vocabulary.
    #[error("not a vocabulary: unknown magic bytes")]
    NotAVocabulary,
    /// This program does not know the version of the vocabulary.
    #[error(
        "the vocabulary has version {found}, but this program reads version {supported}; train it again with it"
    )]
    VocabularyVersion {
        /// The version of the vocabulary.
        found: u32,
        /// The supported version.
        supported: u32,
    },
    /// A vocabulary is truncated, or has extra bytes.
    #[error("the vocabulary should have {expected} bytes by its header, but has {found}")]
    VocabularyLength {
        /// Length by its header (or of the header itself).
        expected: usize,
        /// Actual length.
        found: usize,
    },
}
