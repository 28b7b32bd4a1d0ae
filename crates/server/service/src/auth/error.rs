//! Errors in a token file. No message repeats a line, because a line may hold a secret.

/// What is wrong with a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LineError {
    /// The file is not UTF-8.
    #[error("the file is not UTF-8 text")]
    NoText,
    /// The line has only one word.
    #[error("a name and the SHA-256 of the token are needed, with a space between them")]
    TooShort,
    /// The second word is not a SHA-256.
    #[error("the second word is not a SHA-256: 64 hexadecimal digits (and never the token itself)")]
    Hash,
    /// An unknown word follows.
    #[error(
        "after the SHA-256 only `operator`, `gateway`, `anchors`, `maps=NAME,NAME` and `expires=2027-01-31` may follow, each once"
    )]
    Word,
    /// A word is repeated.
    #[error("`operator`, `gateway`, `anchors`, `maps=` and `expires=` may each appear once")]
    WordTwice,
    /// The list of maps is invalid.
    #[error("`maps=` needs names of maps with commas and no spaces between them; leave it out for all maps")]
    Maps,
    /// The time is invalid.
    #[error("`expires=` needs a day (2027-01-31) or a second in UTC (2027-01-31T00:00:00Z)")]
    Expires,
    /// An operator token is restricted to maps.
    #[error("an operator's token reads the metrics of all maps; leave out `operator` or `maps=`")]
    OperatorOfSome,
    /// Two lines have the same hash.
    #[error("this token appears twice")]
    TokenTwice,
    /// The file has tokens and the line `nobody`.
    #[error("the file has tokens, but the line `nobody` says that it has none")]
    NobodyAndTokens,
}

/// Why a token file cannot be used, or was not changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TokensError {
    /// A line is invalid.
    #[error("line {line}: {fault}")]
    Line {
        /// From 1.
        line: usize,
        /// What is wrong with it.
        fault: LineError,
    },
    /// The file has neither a token nor the line `nobody`.
    #[error(
        "holds no token, so all queries would be refused; add a token, or the line `nobody` if this is intended"
    )]
    Empty,
    /// The name is not valid.
    #[error("a token's name has 1 to 64 letters, digits or `-`, `_`, `.`, `@`, `+`, and is not `nobody`")]
    Name,
    /// The name is taken.
    #[error("a token of this name exists already; revoke it first, or choose another name")]
    NameTaken,
    /// The token exists already.
    #[error("this token exists already")]
    TokenTaken,
    /// No line has this name.
    #[error("no token has this name; `veiloc token list` shows all")]
    Unknown,
    /// The new line would be invalid.
    #[error(transparent)]
    Fault(#[from] LineError),
}
