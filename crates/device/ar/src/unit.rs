//! The unit of a map: stated by its answers, or given by the app.

use veiloc_protocol::Answer;

/// The unit of the map is not known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum UnitError {
    /// The answer does not state it, and none was given.
    #[error(
        "the unit of the map is not known: give metres_per_unit, or give the map metres with `veiloc map align` or \
         `veiloc map build --metres`"
    )]
    Unknown,
    /// The given one is not possible.
    #[error("metres_per_unit must be above 0")]
    NotAboveZero,
}

/// Metres of a unit of the map: the given one, or else the one that the answer states.
///
/// # Errors
/// [`UnitError`].
pub fn metres_per_unit(answer: &Answer, given: Option<f64>) -> Result<f64, UnitError> {
    check_unit(given.or(answer.map.metres_per_unit).ok_or(UnitError::Unknown)?)
}

/// A unit that an app gives: metres, above 0.
///
/// # Errors
/// [`UnitError::NotAboveZero`].
pub fn check_unit(metres: f64) -> Result<f64, UnitError> {
    if metres.is_finite() && metres > 0.0 { Ok(metres) } else { Err(UnitError::NotAboveZero) }
}
