//! What can go wrong in robust estimation, with the facts and, where there is one, the remedy.

/// Why no pose was estimated: what a problem is refused for, then what the search ended with.
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
    /// A rig without frames.
    #[error("a rig without frames has no pose; give it at least one")]
    NoFrames,
    /// A frame of a rig that no pose can be estimated from, whatever the others are.
    #[error("frame {frame}: {source}")]
    Frame {
        /// Which, from 0.
        frame: usize,
        /// What is wrong with it.
        source: Box<PoseError>,
    },
    /// A relative pose with a number that is NaN or infinite.
    #[error("its pose on the rig is not finite")]
    OdometryNotFinite,
    /// Frames may each be too poor for a pose, but not all of them.
    #[error(
        "none of the {frames} frames has enough correspondences for a pose of its own (on both sides of the dividing \
         line, where there is one); one such frame is needed, which the others then help"
    )]
    NoFrameAlone {
        /// How many frames there were.
        frames: usize,
    },
    /// The score cannot weigh frames against each other.
    #[error("the pose of a rig is estimated with the likelihood only; leave the score away")]
    ScoreOfRig,
    /// All lines pass through one anchor: the depth along that anchor's ray cannot be known.
    #[error(
        "all {lines} lines run through the same anchor, which leaves the camera's depth along it free; \
         move or turn the camera so that keypoints lie on both sides of the dividing line"
    )]
    OneSided {
        /// How many lines there were.
        lines: usize,
    },
    /// The best pose agrees with the correspondences no better than a pose that is wrong would.
    #[error(
        "the best pose explains the correspondences no better than chance does (log evidence {log_evidence:.0})"
    )]
    Chance {
        /// [`crate::Confidence::log_evidence`].
        log_evidence: f64,
    },
    /// It was given up: [`crate::PoseOptions::stop`].
    #[error("the search was stopped before its end")]
    Stopped,
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
