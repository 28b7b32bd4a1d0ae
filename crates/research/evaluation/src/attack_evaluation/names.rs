//! Values that are written by their names.

/// A name that is not in a list.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{name:?} is not {what}; use one of {known}")]
pub struct UnknownName {
    name: String,
    what: &'static str,
    known: String,
}

/// The value of this name among all; `what`: a value in words, with its article.
pub(super) fn find<T>(
    text: &str,
    what: &'static str,
    all: impl IntoIterator<Item = T>,
    name_of: impl Fn(&T) -> &'static str,
) -> Result<T, UnknownName> {
    let mut known = Vec::new();
    for value in all {
        if name_of(&value) == text.trim() {
            return Ok(value);
        }
        known.push(name_of(&value));
    }
    Err(UnknownName { name: text.to_owned(), what, known: known.join(", ") })
}
