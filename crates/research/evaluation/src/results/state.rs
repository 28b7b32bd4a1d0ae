//! States in documents: `trusted`, `doubtful`, `not-found`.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serializer};
use veiloc_pose::State;

/// Serializes the state as its text.
///
/// # Errors
/// Errors of the serializer.
pub fn as_text<S: Serializer>(state: &State, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(state)
}

/// The same for an optional state; a missing state is null.
///
/// # Errors
/// Errors of the serializer.
pub fn as_text_if_any<S: Serializer>(state: &Option<State>, serializer: S) -> Result<S::Ok, S::Error> {
    match state {
        Some(state) => as_text(state, serializer),
        None => serializer.serialize_none(),
    }
}

/// Reads a state that [`as_text_if_any`] wrote.
///
/// # Errors
/// Errors of the deserializer, and texts that are not a state.
pub fn from_text_if_any<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<State>, D::Error> {
    let Some(text) = Option::<String>::deserialize(deserializer)? else { return Ok(None) };
    let state = State::ALL.into_iter().find(|state| state.to_string() == text);
    state.map(Some).ok_or_else(|| D::Error::custom(format!("{text:?} is no state")))
}
