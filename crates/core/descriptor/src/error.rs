//! What can be wrong with descriptors and vocabularies.

/// Why descriptors, or a vocabulary, were refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptorError {
    /// Not a name.
    #[error("a name has 1 to 31 characters a-z, 0-9 and -, beginning with a letter")]
    Name,
    /// A number of a kind or of a global model is out of range.
    #[error("descriptor kind: {field} is {value}; allowed is {allowed}")]
    Kind {
        /// Which number.
        field: &'static str,
        /// Its value.
        value: u64,
        /// What it may be.
        allowed: &'static str,
    },
    /// Something built in has this name, and other numbers.
    #[error("the name {name} belongs to something built in, with other numbers; choose another name")]
    NameTaken {
        /// The name.
        name: String,
    },
    /// The bytes are no global model: neither a vocabulary nor a named one.
    #[error("not a global model: the first bytes are no mark of one")]
    NotAGlobalModel,
    /// The bytes of a named global model are not as many as they must be.
    #[error("a named global model has {expected} bytes, {found} are there")]
    GlobalModelLength {
        /// How many it has.
        expected: usize,
        /// How many there were.
        found: usize,
    },
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
    #[error(
        "vocabulary of version {found}, but this program reads version {supported}; train it again with this program"
    )]
    VocabularyVersion {
        /// The version found.
        found: u32,
        /// The one that is read.
        supported: u32,
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
