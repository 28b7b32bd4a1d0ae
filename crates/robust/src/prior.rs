//! What a match is worth before geometry is asked: the probability that it is right.
//!
//! A logistic in the descriptor distance ratio, the number of retrieved images that propose the same pair, and the
//! length of the map point's track:
//!
//! ```text
//! logit γ = offset + a · ratio + b · ln(votes) + c · ln(track length)
//! ```
//!
//! The coefficients were fitted once by `scripts/fit_prior.py`, on mutual nearest neighbours of RootSIFT descriptors
//! without ratio test, a match counting as right when it re-projects within 4 pixels under the true pose. The images are
//! map images of two places (Lund door, Herz-Jesu-P25), each held out of the map it was matched with
//! (`scripts/training_problems.sh`): no query took part. Their mean log loss is 0.123 and 0.199 on the two, 0.279 on
//! RedKitchen, which took no part at all (a fit on RedKitchen itself reaches 0.264); without a prior it would be 0.64 to
//! 0.69.

/// What speaks for or against one match.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// Distance of the nearest descriptor over that of the second nearest, 0 to 1; 1 when there is no second.
    pub ratio: f64,
    /// Retrieved images that propose the pair, if counted.
    pub votes: Option<u32>,
    /// Map images that see the point, if known.
    pub track_length: Option<u32>,
}

/// Coefficients of the logistic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriorModel {
    /// Constant term.
    pub offset: f64,
    /// By the ratio.
    pub ratio: f64,
    /// By the logarithm of the votes.
    pub log_votes: f64,
    /// By the logarithm of the track length.
    pub log_track_length: f64,
}

impl PriorModel {
    /// For matches of which only the ratio is known.
    pub const RATIO: Self = Self { offset: 8.521, ratio: -12.493, log_votes: 0.0, log_track_length: 0.0 };
    /// For ratio and votes.
    pub const RATIO_VOTES: Self =
        Self { offset: 7.310, ratio: -11.384, log_votes: 0.557, log_track_length: 0.0 };
    /// For all three.
    pub const FULL: Self = Self { offset: 7.490, ratio: -11.347, log_votes: 0.581, log_track_length: -0.143 };

    /// Probability that a match is right, strictly between 0 and 1.
    ///
    /// Evidence that is missing counts as 1 (whose logarithm is 0); a ratio that is not a number as 1.
    pub fn probability(&self, evidence: &Evidence) -> f64 {
        let ratio = if evidence.ratio.is_nan() { 1.0 } else { evidence.ratio.clamp(0.0, 1.0) };
        let log = |count: Option<u32>| f64::from(count.unwrap_or(1).max(1)).ln();
        let logit = self.offset
            + self.ratio * ratio
            + self.log_votes * log(evidence.votes)
            + self.log_track_length * log(evidence.track_length);
        1.0 / (1.0 + (-logit).exp())
    }
}

/// Probability that a match is right, by the model for the evidence there is.
pub fn match_probability(evidence: &Evidence) -> f64 {
    let model = match (evidence.votes, evidence.track_length) {
        (Some(_), Some(_)) => PriorModel::FULL,
        (Some(_), None) => PriorModel::RATIO_VOTES,
        (None, _) => PriorModel::RATIO,
    };
    model.probability(evidence)
}

/// Probability that a match with this descriptor distance ratio is right.
pub fn from_ratio(ratio: f64) -> f64 {
    match_probability(&Evidence { ratio, votes: None, track_length: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn better_evidence_gives_a_higher_probability() {
        let at =
            |ratio, votes| match_probability(&Evidence { ratio, votes: Some(votes), track_length: Some(5) });
        assert!(at(0.6, 1) > at(0.9, 1));
        assert!(at(0.9, 5) > at(0.9, 1));
        assert!(from_ratio(0.5) > 0.9 && from_ratio(0.98) < 0.1);
        for ratio in [f64::NAN, f64::INFINITY, -1.0, 0.0, 1.0, 2.0] {
            let p = from_ratio(ratio);
            assert!(p > 0.0 && p < 1.0, "{ratio}: {p}");
        }
    }
}
