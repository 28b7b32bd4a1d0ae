//! States in documents: `trusted`, `doubtful`, `not-found`.

use serde::Serializer;
use veiloc_robust::State;

/// As the state prints itself.
///
/// # Errors
/// Those of the serializer.
pub fn as_text<S: Serializer>(state: &State, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(state)
}

/// The same of a state that may be missing, which is null.
///
/// # Errors
/// Those of the serializer.
pub fn as_text_if_any<S: Serializer>(state: &Option<State>, serializer: S) -> Result<S::Ok, S::Error> {
    match state {
        Some(state) => as_text(state, serializer),
        None => serializer.serialize_none(),
    }
}
