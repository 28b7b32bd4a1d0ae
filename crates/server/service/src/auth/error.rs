//! What can be wrong with a file of tokens. No message repeats what a line holds: it may hold a secret.

/// What is wrong with a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LineFault {
    /// Not UTF-8.
    #[error("the file is no text")]
    NoText,
    /// One word.
    #[error("a name and the SHA-256 of the token are needed, with a space between them")]
    TooShort,
    /// The second word.
    #[error("the second word is not a SHA-256: 64 hexadecimal digits (and never the token itself)")]
    Hash,
    /// Any word after it.
    #[error(
        "after the SHA-256 only `operator`, `maps=NAME,NAME` and `expires=2027-01-31` may follow, each once"
    )]
    Word,
    /// The same again.
    #[error("`operator`, `maps=` and `expires=` may each be there once")]
    WordTwice,
    /// The maps.
    #[error("`maps=` needs names of maps with commas and no spaces between them; leave it out for all maps")]
    Maps,
    /// The end.
    #[error("`expires=` needs a day (2027-01-31) or a second in UTC (2027-01-31T00:00:00Z)")]
    Expires,
    /// An operator's token with maps.
    #[error("an operator's token reads the metrics of all maps; leave out `operator` or `maps=`")]
    OperatorOfSome,
    /// Two lines with one hash.
    #[error("this token is there twice")]
    TokenTwice,
    /// Both.
    #[error("there are tokens, and the line `nobody` says that there are none")]
    NobodyAndTokens,
}

/// Why a file of tokens cannot be used, or was not changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TokensError {
    /// A line that is none.
    #[error("line {line}: {fault}")]
    Line {
        /// From 1.
        line: usize,
        /// What is wrong with it.
        fault: LineFault,
    },
    /// Nobody is let in, and nothing says that this is meant.
    #[error("holds no token, so nobody could ask; add one, or the line `nobody` if that is meant")]
    Empty,
    /// A name that would break the line.
    #[error("a token's name has 1 to 64 letters, digits or `-`, `_`, `.`, `@`, `+`, and is not `nobody`")]
    Name,
    /// A name that is taken.
    #[error("a token of this name is there already; revoke it first, or choose another name")]
    NameTaken,
    /// A hash that is there already.
    #[error("this very token is there already")]
    TokenTaken,
    /// No line has the name.
    #[error("no token of this name is there; `veiloc token list` shows all")]
    Unknown,
    /// What the line would say.
    #[error(transparent)]
    Fault(#[from] LineFault),
}
