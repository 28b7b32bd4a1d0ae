//! The direction of gravity in a map, if known.

use std::fmt;
use std::str::FromStr;

/// The direction of gravity in the axes of the map: a unit vector.
///
/// Structure from motion leaves the axes of a map open, so the builder of the map provides the direction. Queries
/// with a direction of gravity in the camera can then be aligned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GravityDirection([f64; 3]);

/// The vector or text is not a direction.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "{given} is not a direction; write X,Y,Z in the axes of the map, three finite numbers not all 0, or an axis such as y or -z"
)]
pub struct GravityDirectionError {
    /// The given value as text.
    pub given: String,
}

/// Tolerance of the length of a stored unit vector.
const MAX_NORM_ERROR: f64 = 1e-6;

impl GravityDirection {
    /// That of a map whose `z` axis is up.
    pub const MINUS_Z: Self = Self([0.0, 0.0, -1.0]);

    /// From a vector of any length except zero.
    ///
    /// # Errors
    /// [`GravityDirectionError`]: the vector is zero or not finite.
    pub fn new(direction: [f64; 3]) -> Result<Self, GravityDirectionError> {
        let largest = direction.iter().fold(0.0_f64, |most, c| most.max(c.abs()));
        if !direction.iter().all(|c| c.is_finite()) || largest == 0.0 {
            let [x, y, z] = direction;
            return Err(GravityDirectionError { given: format!("{x},{y},{z}") });
        }
        // Scale first, so that no square overflows or underflows. Adding 0 removes the sign of zero.
        let scaled = direction.map(|c| c / largest);
        let norm = scaled.iter().map(|c| c * c).sum::<f64>().sqrt();
        Ok(Self(scaled.map(|c| c / norm + 0.0)))
    }

    /// A stored vector: of unit length up to rounding, and used unchanged, so that a map that is opened and written
    /// again has the same bytes.
    pub(crate) fn from_stored(vector: [f64; 3]) -> Result<Self, String> {
        let off = (vector.iter().map(|c| c * c).sum::<f64>().sqrt() - 1.0).abs();
        if off <= MAX_NORM_ERROR { Ok(Self(vector)) } else { Err("not a unit vector".to_owned()) }
    }

    /// The unit vector.
    pub const fn in_world(&self) -> [f64; 3] {
        self.0
    }
}

/// `X,Y,Z` of any length, or an axis: `x`, `-x`, `y`, `-y`, `z`, `-z`.
impl FromStr for GravityDirection {
    type Err = GravityDirectionError;

    fn from_str(text: &str) -> Result<Self, GravityDirectionError> {
        let text = text.trim();
        let (sign, axis) = text.strip_prefix('-').map_or((1.0, text), |axis| (-1.0, axis));
        if let Some(k) = ["x", "y", "z"].iter().position(|name| *name == axis) {
            let mut along = [0.0; 3];
            along[k] = sign;
            return Ok(Self(along));
        }
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|word| word.trim().parse()).collect();
        match numbers.as_deref() {
            Ok(&[x, y, z]) => Self::new([x, y, z]),
            _ => Err(GravityDirectionError { given: format!("{text:?}") }),
        }
    }
}

/// Four digits, for messages.
impl fmt::Display for GravityDirection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, z] = self.0;
        write!(f, "({x:.4}, {y:.4}, {z:.4})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_and_axis_names_are_parsed() {
        for scale in [1e-300, 1.0, 9.81, 1e300] {
            let [x, y, z] =
                GravityDirection::new([0.0, -3.0 * scale, 4.0 * scale]).expect("a direction").in_world();
            assert!(x == 0.0 && (y + 0.6).abs() < 1e-12 && (z - 0.8).abs() < 1e-12, "{scale}");
        }
        for (text, along) in [
            ("x", [1.0, 0.0, 0.0]),
            ("-y", [0.0, -1.0, 0.0]),
            (" z ", [0.0, 0.0, 1.0]),
            ("0, -9.81, 0", [0.0, -1.0, 0.0]),
        ] {
            assert_eq!(text.parse::<GravityDirection>().expect("a direction").in_world(), along, "{text}");
        }
    }

    #[test]
    fn invalid_directions_are_refused() {
        for text in ["", "-", "w", "xy", "1,2", "1,2,3,4", "0,0,0", "-0,0,0", "NaN,0,1", "inf,0,0", "a,b,c"] {
            let error = text.parse::<GravityDirection>().expect_err(text);
            assert!(error.to_string().contains("X,Y,Z"), "{error}");
        }
        for vector in [[0.0; 3], [1.0, 1.0, 0.0], [f64::NAN, 1.0, 0.0], [f64::INFINITY, 0.0, 0.0]] {
            assert!(GravityDirection::from_stored(vector).is_err(), "{vector:?}");
        }
    }
}
