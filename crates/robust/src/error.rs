//! What can go wrong in robust estimation, with the facts and, where there is one, the remedy.

/// Why no pose was estimated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// Fewer correspondences than a minimal sample needs.
    #[error("{actual} correspondences are too few for a pose, {required} are the least")]
    TooFew {
        /// The size of a minimal sample.
        required: usize,
        /// How many there were.
        actual: usize,
    },
    /// All lines pass through one anchor: the depth along that anchor's ray cannot be known.
    #[error(
        "all {lines} lines run through the same anchor, which leaves the camera's depth along it free; \
         move or turn the camera so that keypoints lie on both sides of the dividing line"
    )]
    OneSided {
        /// How many lines there were.
        lines: usize,
    },
    /// Arrays that belong together differ in length.
    #[error("{what} has {actual} entries, {expected} were expected, one a correspondence")]
    LengthMismatch {
        /// Which array.
        what: &'static str,
        /// The number of observations.
        expected: usize,
        /// Its own length.
        actual: usize,
    },
    /// A number is NaN or infinite.
    #[error("{what} {index} is not finite")]
    NotFinite {
        /// Which array.
        what: &'static str,
        /// Where in it.
        index: usize,
    },
    /// A prior is no probability.
    #[error("the prior of correspondence {index} is {value}, not a probability between 0 and 1")]
    BadPrior {
        /// Which correspondence.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// The camera or an option has an impossible value.
    #[error("{what} is {value}, which is not possible")]
    BadValue {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// The best pose agrees with the correspondences no better than a pose that is wrong would.
    #[error(
        "the best pose explains the correspondences no better than chance does (log evidence {log_evidence:.0})"
    )]
    Chance {
        /// [`crate::Confidence::log_evidence`].
        log_evidence: f64,
    },
    /// No hypothesis was supported by enough keypoints.
    #[error(
        "no pose is supported by the correspondences: the best of {hypotheses} hypotheses has {inliers} inliers, \
         {required} are the least"
    )]
    NoConsensus {
        /// Keypoints that agree with the best pose; 0 when no sample gave a pose.
        inliers: usize,
        /// The least that is accepted.
        required: usize,
        /// Samples drawn.
        hypotheses: usize,
    },
}
