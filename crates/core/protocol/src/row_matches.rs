//! What a device found in a pack: the point that each row is.

use std::fmt;

use crate::QueryError;
use crate::bits::{BitReader, BitWriter};

/// How probable a device takes a match to be before geometry, in 15 steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct MatchWeight(u8);

/// Bits of a weight.
const WEIGHT_BITS: u32 = 4;
/// The code of the probability one half.
const EVEN: u8 = 8;
/// Steps per unit of log odds.
const STEPS_PER_LOGIT: f64 = 2.0;

impl MatchWeight {
    /// The smallest step.
    pub const LEAST: Self = Self(1);

    /// The nearest step.
    pub fn of_probability(probability: f64) -> Self {
        let logit = (probability / (1.0 - probability)).ln();
        let code = (logit * STEPS_PER_LOGIT).round() + f64::from(EVEN);
        Self(if code.is_nan() { EVEN } else { code.clamp(1.0, 15.0) as u8 })
    }

    /// The probability of this step.
    pub fn probability(self) -> f64 {
        let logit = (f64::from(self.0) - f64::from(EVEN)) / STEPS_PER_LOGIT;
        1.0 / (1.0 + (-logit).exp())
    }

    /// 1 to 15.
    const fn from_code(code: u32) -> Option<Self> {
        if code >= 1 && code <= 15 { Some(Self(code as u8)) } else { None }
    }
}

/// The point that a row is taken for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Candidate {
    /// Its number in the pack.
    pub point: u32,
    /// How probable the match is.
    pub weight: MatchWeight,
}

/// The candidate of each row, `[N]`.
#[derive(Clone, PartialEq, Eq)]
pub struct RowMatches {
    /// Points of the pack.
    points: u32,
    rows: Vec<Candidate>,
}

impl RowMatches {
    /// Most points of a pack.
    pub(crate) const MAX_POINTS: u32 = 1 << 24;

    /// The candidates of all rows, of a pack with this many points.
    ///
    /// # Errors
    /// [`QueryError::Mismatch`] for a point that is not below `points`.
    pub fn new(points: u32, rows: Vec<Candidate>) -> Result<Self, QueryError> {
        match rows.iter().position(|candidate| candidate.point >= points) {
            None => Ok(Self { points, rows }),
            Some(row) => {
                let (expected, actual) = (format!("a point below {points}"), format!("another in row {row}"));
                Err(QueryError::Mismatch { what: "candidates", expected, actual })
            }
        }
    }

    /// The candidate of each row, `[N]`.
    pub fn rows(&self) -> &[Candidate] {
        &self.rows
    }

    /// Points of the pack.
    pub const fn points(&self) -> u32 {
        self.points
    }

    /// The first rows.
    #[must_use]
    pub fn first(&self, rows: usize) -> Self {
        Self { points: self.points, rows: self.rows[..rows].to_vec() }
    }

    /// Bits of a point's number.
    pub(crate) fn point_bits(points: u32) -> u32 {
        u32::BITS - points.saturating_sub(1).max(1).leading_zeros()
    }

    /// Bytes of `count` rows on the wire.
    pub(crate) fn packed_len(points: u32, count: usize) -> usize {
        (count * (Self::point_bits(points) + WEIGHT_BITS) as usize).div_ceil(8)
    }

    /// Row by row, the point and then its weight.
    pub(crate) fn pack(&self) -> Vec<u8> {
        let bits = Self::point_bits(self.points);
        let mut writer = BitWriter::with_capacity(Self::packed_len(self.points, self.rows.len()));
        for candidate in &self.rows {
            writer.write(candidate.point, bits);
            writer.write(candidate.weight.0.into(), WEIGHT_BITS);
        }
        writer.finish()
    }

    /// Reads [`Self::pack`]; the length was checked.
    pub(crate) fn unpack(points: u32, count: usize, bytes: &[u8]) -> Result<Self, QueryError> {
        let damaged = |reason: &str| QueryError::Descriptor { what: "candidates", reason: reason.to_owned() };
        let bits = Self::point_bits(points);
        let mut reader = BitReader::new(bytes);
        let mut row = || {
            let (point, code) = (reader.read(bits), reader.read(WEIGHT_BITS));
            let weight = MatchWeight::from_code(code).ok_or_else(|| damaged("a weight is 0"))?;
            Ok(Candidate { point, weight })
        };
        let rows = (0..count).map(|_| row()).collect::<Result<_, QueryError>>()?;
        Self::new(points, rows).map_err(|_| damaged("a point is not in the pack"))
    }
}

// What a row is must not appear in logs (rule L8).
impl fmt::Debug for RowMatches {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "RowMatches({} rows, {} points)", self.rows.len(), self.points)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(point: u32, probability: f64) -> Candidate {
        Candidate { point, weight: MatchWeight::of_probability(probability) }
    }

    #[test]
    fn weights_are_steps_of_log_odds() {
        for (probability, expected) in [(0.5, 0.5), (0.0, 0.029), (1.0, 0.971), (0.9, 0.881), (f64::NAN, 0.5)]
        {
            let weight = MatchWeight::of_probability(probability);
            assert!(
                (weight.probability() - expected).abs() < 1e-3,
                "{probability}: {}",
                weight.probability()
            );
            assert_eq!(MatchWeight::of_probability(weight.probability()), weight);
        }
    }

    #[test]
    fn rows_round_trip() {
        let matches =
            RowMatches::new(1000, vec![candidate(999, 0.9), candidate(0, 0.5)]).expect("in the pack");
        let bytes = matches.pack();
        assert_eq!(bytes.len(), RowMatches::packed_len(1000, 2));
        assert_eq!(RowMatches::unpack(1000, 2, &bytes), Ok(matches));
        assert_eq!(RowMatches::packed_len(1, 8), RowMatches::packed_len(2, 8), "one bit at least");
    }

    #[test]
    fn other_rows_are_refused() {
        assert!(RowMatches::new(1000, vec![candidate(1000, 0.5)]).is_err());
        // No weight; a point of which the pack has no more.
        for (point, weight) in [(5, 0), (6, 3)] {
            let mut writer = BitWriter::with_capacity(1);
            writer.write(point, 3);
            writer.write(weight, WEIGHT_BITS);
            assert!(RowMatches::unpack(6, 1, &writer.finish()).is_err(), "{point} {weight}");
        }
    }
}
