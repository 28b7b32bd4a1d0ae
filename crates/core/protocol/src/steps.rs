//! Progressive queries: a sealed query sent in steps, a few rows first (decision 0020).
//!
//! Every step is a prefix of one sealed query. Its rows were shuffled when it was sealed, so a prefix is a random
//! subset; and a row is identical in all steps that contain it, so that all steps together reveal exactly what the
//! whole query reveals (rule L7).

use crate::{Profile, QueryContent, QueryError, SealedQuery, SizeClass};

/// When a progressive query ends.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StopCriterion {
    accuracy: Option<f64>,
}

impl StopCriterion {
    /// With the first trusted pose, regardless of its accuracy.
    pub const TRUSTED: Self = Self { accuracy: None };

    /// With the first trusted pose whose position has at most this standard deviation in its least certain direction,
    /// map units. `None` for a number that is not above 0.
    pub fn accurate_to(position_sd: f64) -> Option<Self> {
        (position_sd.is_finite() && position_sd > 0.0).then_some(Self { accuracy: Some(position_sd) })
    }

    /// Whether the query ends with this pose. A deviation that is NaN does not end it.
    pub fn is_met(&self, trusted: bool, position_sd: f64) -> bool {
        trusted && self.accuracy.is_none_or(|most| position_sd <= most)
    }
}

impl SealedQuery {
    /// The query of its first rows, as many as the class has. All fields of the image stay the same; a global
    /// descriptor that is computed from rows is computed from these rows alone.
    ///
    /// # Errors
    /// [`QueryError::WrongProfile`] and [`QueryError::Mismatch`] when it was not sealed with this profile, or has fewer
    /// rows.
    pub fn first_rows(&self, class: SizeClass, profile: &Profile) -> Result<Self, QueryError> {
        profile.check(self)?;
        let rows = class.rows();
        if rows > self.len() {
            let (expected, actual) = (format!("at least {rows}"), self.len().to_string());
            return Err(QueryError::Mismatch { what: "rows", expected, actual });
        }
        let content = match &self.content {
            QueryContent::Described { descriptors, global } => {
                let descriptors = descriptors.select(0..rows);
                // A global descriptor of the image does not depend on the number of rows that are sent.
                let of_rows = profile.global_model().of_rows(descriptors.view());
                QueryContent::Described { descriptors, global: of_rows.unwrap_or_else(|| global.clone()) }
            }
            QueryContent::Matched { kind, pack, matches } => {
                QueryContent::Matched { kind: *kind, pack: *pack, matches: matches.first(rows) }
            }
        };
        Ok(Self { rows: self.rows.first(rows), content, ..self.clone() })
    }

    /// The sizes of its steps: all classes up to its own.
    pub fn step_sizes(&self) -> impl Iterator<Item = SizeClass> + use<> {
        let rows = self.len();
        SizeClass::ALL.into_iter().filter(move |class| class.rows() <= rows)
    }

    /// The sizes of its steps that can determine a pose: with enough rows on each side of the dividing line. None when
    /// the whole query cannot, or was not sealed with this profile.
    pub fn useful_steps(&self, profile: &Profile) -> impl Iterator<Item = SizeClass> {
        self.step_sizes().filter(|class| {
            let part = self.first_rows(*class, profile);
            part.is_ok_and(|part| part.check_sides().is_ok())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn untrusted_or_inexact_poses_do_not_stop_the_query() {
        let close = StopCriterion::accurate_to(0.02).expect("a deviation");
        for (trusted, sd, first, exact) in [
            (true, 0.01, true, true),
            (true, 0.02, true, true),
            (true, 0.03, true, false),
            (true, f64::INFINITY, true, false),
            (true, f64::NAN, true, false),
            (false, 0.01, false, false),
        ] {
            assert_eq!(StopCriterion::TRUSTED.is_met(trusted, sd), first, "{trusted} {sd}");
            assert_eq!(close.is_met(trusted, sd), exact, "{trusted} {sd}");
        }
        for none in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(StopCriterion::accurate_to(none), None);
        }
    }
}
