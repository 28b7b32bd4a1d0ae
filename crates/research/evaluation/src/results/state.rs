//! States in documents: `trusted`, `doubtful`, `not-found`.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serializer};
use veiloc_pose::State;

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

/// The state that [`as_text_if_any`] wrote.
///
/// # Errors
/// Those of the deserializer, and for a text that is no state.
pub fn from_text_if_any<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<State>, D::Error> {
    let Some(text) = Option::<String>::deserialize(deserializer)? else { return Ok(None) };
    let state = State::ALL.into_iter().find(|state| state.to_string() == text);
    state.map(Some).ok_or_else(|| D::Error::custom(format!("{text:?} is no state")))
}
