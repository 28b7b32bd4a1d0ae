//! Edits the text of a token file. All other lines stay unchanged, comments included; a byte order mark is removed.

use crate::auth::entry::TokenEntry;
use crate::auth::error::TokensError;
use crate::auth::list::{Line, TokenList};

/// The text with one more token; a line `nobody` is removed.
///
/// # Errors
/// [`TokensError`]: the name or the token exists already, or the text is not a valid token file. Empty text is
/// accepted.
pub fn added(text: &str, entry: &TokenEntry) -> Result<String, TokensError> {
    entry.check()?;
    let list = match TokenList::parse(text.as_bytes()) {
        Err(TokensError::Empty) => TokenList::default(),
        read => read?,
    };
    if list.entries().iter().any(|other| other.name() == entry.name()) {
        return Err(TokensError::NameTaken);
    }
    if list.find(&entry.key()).is_some() {
        return Err(TokensError::TokenTaken);
    }
    let mut new = without(text, |line| matches!(line, Line::Nobody)).0;
    if !new.is_empty() && !new.ends_with('\n') {
        new.push('\n');
    }
    Ok(format!("{new}{entry}\n"))
}

/// Result of revoking a token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Revocation {
    /// The new text.
    pub text: String,
    /// Number of removed lines; older files may have several lines per name.
    pub lines: usize,
    /// Whether these were the last tokens; then the text ends with `nobody`.
    pub was_last: bool,
}

/// The text without the tokens of this name. If they were the last ones, the line `nobody` is added: a file without
/// tokens and without this line is an error, and the last valid tokens would stay in force for a while.
///
/// # Errors
/// [`TokensError`]: no token has this name, or the text is not a valid token file.
pub fn revoked(text: &str, name: &str) -> Result<Revocation, TokensError> {
    let count = TokenList::parse(text.as_bytes())?.entries().len();
    let (mut text, lines) = without(text, |line| matches!(line, Line::Token(entry) if entry.name() == name));
    if lines == 0 {
        return Err(TokensError::Unknown);
    }
    let was_last = lines == count;
    if was_last {
        if !text.is_empty() && !text.ends_with('\n') {
            text.push('\n');
        }
        text += "nobody\n";
    }
    Ok(Revocation { text, lines, was_last })
}

/// The text without the matching lines, and their number.
fn without(text: &str, matches: impl Fn(&Line) -> bool) -> (String, usize) {
    // Otherwise the first line would not be recognized, although the service accepts it.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut removed = 0;
    let mut rest = String::with_capacity(text.len());
    for line in text.split_inclusive('\n') {
        if Line::parse(line).is_ok_and(|line| matches(&line)) {
            removed += 1;
        } else {
            rest += line;
        }
    }
    (rest, removed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::auth::key::TokenKey;

    fn entry(name: &str) -> TokenEntry {
        TokenEntry::new(name, TokenKey::of_token(name.as_bytes())).expect("a name")
    }

    #[test]
    fn other_lines_are_unchanged() {
        let a = entry("a").to_string();
        let text = format!("# phones\r\n\n  {a}  \n# the end");
        let two = added(&text, &entry("b")).expect("added");
        assert_eq!(two, format!("{text}\n{}\n", entry("b")));
        assert_eq!(added(&two, &entry("b")), Err(TokensError::NameTaken));
        let again = TokenEntry::new("c", entry("a").key()).expect("a name");
        assert_eq!(added(&two, &again), Err(TokensError::TokenTaken));
        let one = revoked(&two, "a").expect("revoked");
        assert_eq!(one.text, format!("# phones\r\n\n# the end\n{}\n", entry("b")));
        assert_eq!((one.lines, one.was_last), (1, false));
        assert_eq!(revoked(&one.text, "a"), Err(TokensError::Unknown));
        let none = revoked(&one.text, "b").expect("revoked");
        assert!(none.was_last && none.text.ends_with("# the end\nnobody\n"), "{none:?}");
        let back = added(&none.text, &entry("b")).expect("added");
        assert_eq!(back, one.text, "the line `nobody` is removed");
        assert_eq!(added("", &entry("a")).expect("the first"), format!("{a}\n"));
    }

    #[test]
    fn first_line_after_a_byte_order_mark_is_edited() {
        let text = format!("\u{feff}{}\r\n{}\r\n", entry("a"), entry("b"));
        let one = revoked(&text, "a").expect("revoked");
        assert_eq!((one.text, one.lines), (format!("{}\r\n", entry("b")), 1));
        assert_eq!(added("\u{feff}nobody\r\n", &entry("a")).expect("added"), format!("{}\n", entry("a")));
    }

    #[test]
    fn revoking_removes_all_lines_of_a_name() {
        let second = TokenEntry::new("a", TokenKey::of_token(b"second")).expect("a name");
        let text = format!("{}\n{second}", entry("a"));
        let removed = revoked(&text, "a").expect("revoked");
        assert_eq!((removed.text.as_str(), removed.lines, removed.was_last), ("nobody\n", 2, true));
        for wrong in ["a b\n", "nobody\nnobody x\n"] {
            assert!(
                matches!(added(wrong, &entry("n")), Err(TokensError::Line { .. } | TokensError::Empty)),
                "{wrong}"
            );
            assert!(
                matches!(revoked(wrong, "a"), Err(TokensError::Line { .. } | TokensError::Empty)),
                "{wrong}"
            );
        }
        let mut bound = entry("b");
        bound.operator = true;
        bound.grant_maps(["m"]).expect("names");
        assert!(matches!(added("", &bound), Err(TokensError::Fault(_))));
        for bad in ["", "nobody", "a b", "#a", "a\nb", "ä", &"x".repeat(65)] {
            assert_eq!(TokenEntry::new(bad, TokenKey::of_token(b"x")), Err(TokensError::Name), "{bad:?}");
        }
    }
}
