//! Where a camera roughly is, as a caller may say beside a query: from GPS, a beacon, the pose of a moment ago.
//!
//! It is no part of a sealed query: it goes along with one request, when the caller says so, and nowhere else.

use std::fmt;
use std::str::FromStr;

use crate::QueryError;

/// A place in the map and how far off it may be: a normal distribution.
#[derive(Clone, Copy, PartialEq)]
pub struct PositionHint {
    center: [f64; 3],
    sd: f64,
}

impl PositionHint {
    /// `center`: where, map units. `sd`: standard deviation along each axis of the map, map units.
    ///
    /// # Errors
    /// [`QueryError::PositionHint`] for numbers that are not finite, and a deviation that is not above 0.
    pub fn new(center: [f64; 3], sd: f64) -> Result<Self, QueryError> {
        if center.iter().all(|c| c.is_finite()) && sd.is_finite() && sd > 0.0 {
            Ok(Self { center, sd })
        } else {
            Err(QueryError::PositionHint)
        }
    }

    /// Where, map units.
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

/// `X,Y,Z,SD` as it goes into a header: each number as long as the others, so that the length of a request does not tell
/// how many digits a place has. Exact to the last bit.
impl fmt::Display for PositionHint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, z] = self.center;
        let number = |value: f64| {
            // 17 digits are every double; the exponent has two or three digits and a sign or none.
            let text = format!("{value:+.16e}");
            let (digits, exponent) = text.split_once('e').unwrap_or((&text, "0"));
            let exponent: i32 = exponent.parse().unwrap_or_default();
            format!("{digits}e{exponent:+04}")
        };
        write!(f, "{},{},{},{}", number(x), number(y), number(z), number(self.sd))
    }
}

// Where somebody is has no place in a log.
impl fmt::Debug for PositionHint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PositionHint")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_and_has_one_length() {
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
    fn what_is_no_place_is_refused() {
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
