//! Names of groups: a few words without characters that are special in NATS.

use std::fmt;
use std::sync::Arc;

/// The word cannot be a part of a subject.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} cannot be a part of a subject; use letters, digits, `-`, `_` and `.`, 512 characters in all")]
pub struct InvalidSubjectWord(pub String);

/// Name of a group: words separated by dots. Clones are cheap.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Subject(Arc<str>);

impl Subject {
    /// Maximum number of characters.
    pub const MAX_LEN: usize = 512;

    /// From non-empty words of letters, digits, `-`, `_` and `.`. A dot within a word is written as `~`, so that
    /// different words never give the same subject.
    ///
    /// # Errors
    /// [`InvalidSubjectWord`]: a word has other characters, there is no word, or the subject is too long.
    pub fn new<'a>(words: impl IntoIterator<Item = &'a str>) -> Result<Self, InvalidSubjectWord> {
        let mut subject = String::new();
        for word in words {
            let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
            if word.is_empty() || !word.chars().all(plain) {
                return Err(InvalidSubjectWord(word.to_owned()));
            }
            if !subject.is_empty() {
                subject.push('.');
            }
            subject.extend(word.chars().map(|c| if c == '.' { '~' } else { c }));
        }
        if subject.is_empty() || subject.len() > Self::MAX_LEN {
            return Err(InvalidSubjectWord(subject));
        }
        Ok(Self(subject.into()))
    }

    /// Subject of the cancel messages of this group. No group has this name, because it has one word more than any
    /// group.
    pub(crate) fn of_cancels(&self) -> String {
        format!("{}.cancel", self.0)
    }

    /// The subject as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Subject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn subjects_are_unique_and_free_of_special_characters() {
        let subject = |words: &[&str]| Subject::new(words.iter().copied());
        assert_eq!(subject(&["a", "b.c", "D-_9"]).expect("plain").as_str(), "a.b~c.D-_9");
        assert_ne!(subject(&["a", "b.c"]).expect("plain"), subject(&["a", "b", "c"]).expect("plain"));
        for bad in ["", "*", ">", "a b", "a~b", "ä", "a\n", "$SYS"] {
            assert!(matches!(subject(&["a", bad]), Err(InvalidSubjectWord(_))), "{bad:?}");
        }
        assert!(subject(&[]).is_err() && subject(&[&"x".repeat(513)]).is_err());
    }
}
