//! What speaks for a match of a kind before geometry is asked, as numbers; `veiloc-pose` computes with them.

/// Coefficients of a logistic: `logit γ = offset + a · ratio + b · ln(votes) + c · ln(track length)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriorModel {
    /// Constant term.
    pub offset: f64,
    /// By the ratio of the nearest to the second nearest distance, 0 to 1.
    pub ratio: f64,
    /// By the logarithm of the number of retrieved images that propose the pair.
    pub log_votes: f64,
    /// By the logarithm of the length of the map point's track.
    pub log_track_length: f64,
}

/// One model for each set of evidence there can be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatchPrior {
    /// When the ratio is known only.
    pub ratio: PriorModel,
    /// For ratio and votes.
    pub ratio_votes: PriorModel,
    /// For all three.
    pub full: PriorModel,
}
