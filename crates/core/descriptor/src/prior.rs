//! The prior of a match: the probability that it is right before geometry is considered.
//!
//! A logistic in the descriptor distance ratio, the number of retrieved images that propose the same pair, and the
//! length of the map point's track:
//!
//! ```text
//! logit γ = offset + a · ratio + b · ln(votes) + c · ln(track length)
//! ```
//!
//! The coefficients belong to the descriptor kind ([`MatchPrior`], from [`crate::DescriptorKind::match_prior`]). Those of
//! RootSIFT were fitted once by `study features match-prior`, on mutual nearest neighbours without ratio test; a match counts
//! as right when it re-projects within 4 pixels under the true pose. The images are map images of two scenes (Lund
//! door, Herz-Jesu-P25), each held out of the map it was matched with (`study features training-problems`): no query was
//! used. Their mean log loss is 0.123 and 0.199 on the two scenes, 0.279 on RedKitchen, which was not used for fitting
//! (a fit on RedKitchen itself reaches 0.264); without a prior it would be 0.64 to 0.69. Those of compact descriptors,
//! fitted in the same way: 0.124, 0.214 and 0.287.

/// Coefficients of a logistic: `logit γ = offset + a · ratio + b · ln(votes) + c · ln(track length)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriorModel {
    /// Constant term.
    pub offset: f64,
    /// Coefficient of the ratio of the nearest to the second nearest distance, 0 to 1.
    pub ratio: f64,
    /// Coefficient of the logarithm of the number of retrieved images that propose the pair.
    pub log_votes: f64,
    /// Coefficient of the logarithm of the length of the map point's track.
    pub log_track_length: f64,
}

/// One model for each combination of evidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatchPrior {
    /// For the ratio only.
    pub ratio: PriorModel,
    /// For ratio and votes.
    pub ratio_votes: PriorModel,
    /// For all three.
    pub full: PriorModel,
}

/// Properties of one match that predict whether it is right.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatchEvidence {
    /// Distance of the nearest descriptor over that of the second nearest, 0 to 1; 1 when there is no second.
    pub ratio: f64,
    /// Retrieved images that propose the pair, if counted.
    pub votes: Option<u32>,
    /// Map images that see the point, if known.
    pub track_length: Option<u32>,
}

/// Probability that a match is right by one model, strictly between 0 and 1.
///
/// Missing properties count as 1 (whose logarithm is 0); a ratio that is NaN as 1.
pub fn probability(model: &PriorModel, evidence: &MatchEvidence) -> f64 {
    let ratio = if evidence.ratio.is_nan() { 1.0 } else { evidence.ratio.clamp(0.0, 1.0) };
    let log = |count: Option<u32>| f64::from(count.unwrap_or(1).max(1)).ln();
    let logit = model.offset
        + model.ratio * ratio
        + model.log_votes * log(evidence.votes)
        + model.log_track_length * log(evidence.track_length);
    1.0 / (1.0 + (-logit).exp())
}

/// Probability that a match is right, by the kind's model for the available properties.
pub fn match_probability(prior: &MatchPrior, evidence: &MatchEvidence) -> f64 {
    let model = match (evidence.votes, evidence.track_length) {
        (Some(_), Some(_)) => &prior.full,
        (Some(_), None) => &prior.ratio_votes,
        (None, _) => &prior.ratio,
    };
    probability(model, evidence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DescriptorKind;

    #[test]
    fn better_evidence_gives_a_higher_probability() {
        let prior = DescriptorKind::ROOT_SIFT.match_prior();
        let at = |ratio, votes, track_length| {
            match_probability(&prior, &MatchEvidence { ratio, votes, track_length })
        };
        assert!(at(0.6, Some(1), Some(5)) > at(0.9, Some(1), Some(5)));
        assert!(at(0.9, Some(5), Some(5)) > at(0.9, Some(1), Some(5)));
        assert!(at(0.5, None, None) > 0.9 && at(0.98, None, None) < 0.1);
        for ratio in [f64::NAN, f64::INFINITY, -1.0, 0.0, 1.0, 2.0] {
            let p = at(ratio, None, None);
            assert!(p > 0.0 && p < 1.0, "{ratio}: {p}");
        }
    }

    #[test]
    fn unfitted_kind_has_a_weaker_prior() {
        let spread = |kind: DescriptorKind| {
            let at = |ratio| {
                match_probability(
                    &kind.match_prior(),
                    &MatchEvidence { ratio, votes: None, track_length: None },
                )
            };
            at(0.4) - at(0.95)
        };
        let own = DescriptorKind::new("own", 64, crate::Encoding::Signed, 127).expect("a kind");
        assert!(spread(own) > 0.5 && spread(own) < spread(DescriptorKind::ROOT_SIFT));
    }
}
