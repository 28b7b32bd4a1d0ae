//! Approximate position of a camera, given by the caller beside a query: from GPS, a beacon, or an earlier pose.
//!
//! It is not part of a sealed query: it is sent with one request, and only when the caller gives it.

use std::fmt;
use std::str::FromStr;

use crate::QueryError;

/// A position in the map and its uncertainty: a normal distribution.
#[derive(Clone, Copy, PartialEq)]
pub struct PositionHint {
    center: [f64; 3],
    sd: f64,
}

impl PositionHint {
    /// `center`: the position, map units. `sd`: standard deviation along each axis of the map, map units.
    ///
    /// # Errors
    /// [`QueryError::PositionHint`] for numbers that are not finite, and for a deviation that is not above 0.
    pub fn new(center: [f64; 3], sd: f64) -> Result<Self, QueryError> {
        if center.iter().all(|c| c.is_finite()) && sd.is_finite() && sd > 0.0 {
            Ok(Self { center, sd })
        } else {
            Err(QueryError::PositionHint)
        }
    }

    /// The position, map units.
    pub const fn center(self) -> [f64; 3] {
        self.center
    }

    /// Standard deviation along each axis, map units.
    pub const fn sd(self) -> f64 {
        self.sd
    }
}

/// `X,Y,Z,SD`.
impl FromStr for PositionHint {
    type Err = QueryError;

    fn from_str(text: &str) -> Result<Self, QueryError> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|word| word.trim().parse()).collect();
        match numbers.as_deref() {
            Ok(&[x, y, z, sd]) => Self::new([x, y, z], sd),
            _ => Err(QueryError::PositionHint),
        }
    }
}

/// `X,Y,Z,SD` in the form of the header: all numbers have equal length, so that the length of a request does not reveal
/// the number of digits. Exact to the last bit.
impl fmt::Display for PositionHint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, z] = self.center;
        let number = |value: f64| {
            // 17 digits represent every double; the exponent has two or three digits and an optional sign.
            let text = format!("{value:+.16e}");
            let (digits, exponent) = text.split_once('e').unwrap_or((&text, "0"));
            let exponent: i32 = exponent.parse().unwrap_or_default();
            format!("{digits}e{exponent:+04}")
        };
        write!(f, "{},{},{},{}", number(x), number(y), number(z), number(self.sd))
    }
}

// A position must not appear in logs.
impl fmt::Debug for PositionHint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PositionHint")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_round_trips_with_constant_length() {
        let length = PositionHint::new([0.0; 3], 1.0).expect("a place").to_string().len();
        for values in
            [[1.5, -2.0, 1e-300, 3.0], [123_456.789, 0.1, -1e300, 1e-9], [-0.0, 1.0 / 3.0, f64::MAX, 7e22]]
        {
            let hint = PositionHint::new([values[0], values[1], values[2]], values[3]).expect("a place");
            let text = hint.to_string();
            assert_eq!(text.len(), length, "{text}");
            assert_eq!(text.parse(), Ok(hint), "{text}");
            assert!(!format!("{hint:?}").contains(char::is_numeric));
        }
        let spaced = " 1, 2 ,3,\t0.5".parse::<PositionHint>().expect("a place");
        assert_eq!((spaced.center(), spaced.sd()), ([1.0, 2.0, 3.0], 0.5));
    }

    #[test]
    fn invalid_positions_are_rejected() {
        for text in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "1,2,3,0",
            "1,2,3,-1",
            "1,2,x,1",
            "NaN,0,0,1",
            "1,2,inf,1",
            "1,2,3,inf",
        ] {
            assert_eq!(text.parse::<PositionHint>(), Err(QueryError::PositionHint), "{text}");
        }
    }
}
