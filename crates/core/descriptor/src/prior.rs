//! Priors of the matches of a kind before geometry, as numbers; `veiloc-pose` computes with them.

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
