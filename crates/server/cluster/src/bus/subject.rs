//! Names of groups: a few words, each of characters that mean nothing to any bus.

use std::fmt;
use std::sync::Arc;

/// A word that cannot be a part of a subject.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} cannot be a part of a subject; use letters, digits, `-`, `_` and `.`, 512 characters in all")]
pub struct BadWord(pub String);

/// What a group is called: words with dots between them. A clone costs nothing.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Subject(Arc<str>);

impl Subject {
    /// Most characters of a subject.
    pub const LONGEST: usize = 512;

    /// Of these words: letters, digits, `-`, `_` and `.`; none is empty. A dot within a word is written as `~`, so that
    /// different words never make the same subject.
    ///
    /// # Errors
    /// [`BadWord`] for a word with other characters, no word at all, or too long a subject.
    pub fn new<'a>(words: impl IntoIterator<Item = &'a str>) -> Result<Self, BadWord> {
        let mut subject = String::new();
        for word in words {
            let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
            if word.is_empty() || !word.chars().all(plain) {
                return Err(BadWord(word.to_owned()));
            }
            if !subject.is_empty() {
                subject.push('.');
            }
            subject.extend(word.chars().map(|c| if c == '.' { '~' } else { c }));
        }
        if subject.is_empty() || subject.len() > Self::LONGEST {
            return Err(BadWord(subject));
        }
        Ok(Self(subject.into()))
    }

    /// Where the members of this group hear what is no longer waited for. No group has this name: its words would be one
    /// more than those of any that is asked.
    pub(crate) fn of_cancels(&self) -> String {
        format!("{}.cancel", self.0)
    }

    /// As the bus has it.
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
    fn different_words_make_different_subjects_and_nothing_means_anything() {
        let subject = |words: &[&str]| Subject::new(words.iter().copied());
        assert_eq!(subject(&["a", "b.c", "D-_9"]).expect("plain").as_str(), "a.b~c.D-_9");
        assert_ne!(subject(&["a", "b.c"]).expect("plain"), subject(&["a", "b", "c"]).expect("plain"));
        for bad in ["", "*", ">", "a b", "a~b", "ä", "a\n", "$SYS"] {
            assert!(matches!(subject(&["a", bad]), Err(BadWord(_))), "{bad:?}");
        }
        assert!(subject(&[]).is_err() && subject(&[&"x".repeat(513)]).is_err());
    }
}
