//! The content of a token file.

use std::collections::HashMap;

use veiloc_map::text::without_mark;

use crate::auth::entry::TokenEntry;
use crate::auth::error::{LineError, TokensError};
use crate::auth::key::TokenKey;

/// All tokens, indexed by hash.
#[derive(Debug, Default)]
pub struct TokenList {
    /// In file order.
    entries: Vec<TokenEntry>,
    of_key: HashMap<TokenKey, usize>,
}

/// One line of the file.
pub(crate) enum Line {
    /// An empty line or a comment.
    Nothing,
    /// The line `nobody`: the file has no tokens on purpose.
    Nobody,
    Token(TokenEntry),
}

impl Line {
    pub(crate) fn parse(line: &str) -> Result<Self, LineError> {
        match line.trim() {
            "" => Ok(Self::Nothing),
            comment if comment.starts_with('#') => Ok(Self::Nothing),
            "nobody" => Ok(Self::Nobody),
            token => token.parse().map(Self::Token),
        }
    }
}

impl TokenList {
    /// Parses the bytes of a token file.
    ///
    /// # Errors
    /// [`TokensError`]: an invalid line, two lines with the same token, or a file without any token.
    pub fn parse(bytes: &[u8]) -> Result<Self, TokensError> {
        let at = |line, fault| TokensError::Line { line, fault };
        let text = std::str::from_utf8(without_mark(bytes)).map_err(|error| {
            let before = String::from_utf8_lossy(&bytes[..error.valid_up_to()]);
            at(1 + before.matches('\n').count(), LineError::NoText)
        })?;
        let mut list = Self::default();
        let mut nobody = None;
        for (number, line) in (1..).zip(text.lines()) {
            match Line::parse(line).map_err(|fault| at(number, fault))? {
                Line::Nothing => {}
                Line::Nobody => nobody = Some(number),
                Line::Token(entry) => {
                    if list.of_key.insert(entry.key(), list.entries.len()).is_some() {
                        return Err(at(number, LineError::TokenTwice));
                    }
                    list.entries.push(entry);
                }
            }
        }
        match (nobody, list.entries.is_empty()) {
            (Some(line), false) => Err(at(line, LineError::NobodyAndTokens)),
            (None, true) => Err(TokensError::Empty),
            _ => Ok(list),
        }
    }

    /// All tokens in file order; empty for the line `nobody`.
    pub fn entries(&self) -> &[TokenEntry] {
        &self.entries
    }

    /// The token with this hash.
    pub fn find(&self, key: &TokenKey) -> Option<&TokenEntry> {
        self.of_key.get(key).map(|at| &self.entries[*at])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `printf %s secret | openssl dgst -sha256`
    const SECRET: &str = "2bb80d537b1da3e38bd30361aa855686bde0eacd7162fef6a25fe97bf527a25b";
    const OTHER: &str = "d9298a10d1b0735837dc4bd85dac641b0f3cef27a47e5d53a54f2f3f5b2fcffa";

    fn read(text: &str) -> Result<TokenList, TokensError> {
        TokenList::parse(text.as_bytes())
    }

    #[test]
    fn lines_without_maps_and_expiry_are_read() {
        let list = read(&format!("# phones\n\nphone {SECRET}\n ops\t{} operator\r\n", OTHER.to_uppercase()))
            .expect("a file");
        let [phone, ops] = list.entries() else { panic!("{list:?}") };
        assert_eq!((phone.name(), phone.operator), ("phone", false));
        assert_eq!((ops.name(), ops.operator), ("ops", true));
        for entry in [phone, ops] {
            assert!(
                entry.allows_map("anything") && !entry.has_expired(crate::auth::Timestamp::of_unix(i64::MAX))
            );
        }
        assert_eq!(list.find(&TokenKey::of_token(b"secret")).map(TokenEntry::name), Some("phone"));
        assert!(list.find(&TokenKey::of_token(SECRET.as_bytes())).is_none(), "a hash is no token");
        assert!(read("# closed\nnobody\n").expect("nobody").entries().is_empty());
    }

    #[test]
    fn maps_and_expiry_restrict_a_token() {
        let list = read(&format!("phone {SECRET} expires=2027-01-31 maps=b,a,b")).expect("a file");
        let phone = &list.entries()[0];
        assert_eq!(phone.maps().expect("some").collect::<Vec<_>>(), ["a", "b"]);
        assert!(phone.allows_map("a") && !phone.allows_map("c") && !phone.allows_map(""));
        let end: crate::auth::Timestamp = "2027-01-31T00:00:00Z".parse().expect("a timestamp");
        assert!(
            phone.has_expired(end) && !phone.has_expired(crate::auth::Timestamp::of_unix(end.unix() - 1))
        );
        assert_eq!(phone.to_string(), format!("phone {SECRET} maps=a,b expires=2027-01-31T00:00:00Z"));
    }

    #[test]
    fn invalid_lines_are_numbered_and_not_repeated() {
        use LineError as F;
        for (text, line, fault) in [
            ("phone".to_owned(), 1, F::TooShort),
            ("\nphone hunter2".to_owned(), 2, F::Hash),
            (format!("phone {}", &SECRET[1..]), 1, F::Hash),
            (format!("phone {SECRET}0"), 1, F::Hash),
            (format!("phone +{}", &SECRET[1..]), 1, F::Hash),
            (format!("phone {SECRET} admin"), 1, F::Word),
            (format!("phone {SECRET} operator too"), 1, F::Word),
            (format!("phone {SECRET} operator operator"), 1, F::WordTwice),
            (format!("phone {SECRET} maps=a maps=b"), 1, F::WordTwice),
            (format!("phone {SECRET} maps="), 1, F::Maps),
            (format!("phone {SECRET} maps=a,,b"), 1, F::Maps),
            (format!("phone {SECRET} maps=a/b"), 1, F::Maps),
            (format!("phone {SECRET} maps=a operator"), 1, F::OperatorOfSome),
            (format!("phone {SECRET} expires=soon"), 1, F::Expires),
            (format!("phone {SECRET} Expires=2027-01-31"), 1, F::Word),
            (format!("a {SECRET}\nb {SECRET}"), 2, F::TokenTwice),
            (format!("a {SECRET}\nnobody"), 2, F::NobodyAndTokens),
        ] {
            let error = read(&text).expect_err(&text);
            assert_eq!(error, TokensError::Line { line, fault }, "{text}");
            let message = error.to_string();
            assert!(!message.contains("hunter2") && !message.contains(&SECRET[..8]), "{message}");
        }
        let bytes = [b"a\nb\n".as_slice(), &[0xFF]].concat();
        let error = TokenList::parse(&bytes).expect_err("no text");
        assert_eq!(error, TokensError::Line { line: 3, fault: F::NoText });
        for empty in ["", "\n\n", "# phones\n"] {
            assert_eq!(read(empty).expect_err(empty), TokensError::Empty);
        }
    }
}
