//! Errors of robust estimation, with the facts and, where there is one, the remedy.

/// Why no pose was estimated: first invalid problems, then results of the search.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// Fewer correspondences than a minimal sample needs.
    #[error("{actual} correspondences are too few for a pose; at least {required} are needed")]
    TooFew {
        /// The size of a minimal sample.
        required: usize,
        /// How many there were.
        actual: usize,
    },
    /// Arrays that belong together differ in length.
    #[error("{what} has {actual} entries, but {expected} are required, one per correspondence")]
    LengthMismatch {
        /// Which array.
        what: &'static str,
        /// The number of observations.
        expected: usize,
        /// The length of the array.
        actual: usize,
    },
    /// A number is NaN or infinite.
    #[error("{what} {index} is not finite")]
    NotFinite {
        /// Which array.
        what: &'static str,
        /// The index.
        index: usize,
    },
    /// A prior is not a probability.
    #[error("the prior of correspondence {index} is {value}, not a probability between 0 and 1")]
    BadPrior {
        /// Which correspondence.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// The camera or an option has an impossible value.
    #[error("{what} is {value}, which is not allowed")]
    BadValue {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A rig without frames.
    #[error("a rig without frames has no pose; give at least one frame")]
    NoFrames,
    /// An invalid frame of a rig; the other frames cannot compensate for it.
    #[error("frame {frame}: {source}")]
    Frame {
        /// Index of the frame, from 0.
        frame: usize,
        /// The error of the frame.
        source: Box<PoseError>,
    },
    /// A relative pose with a number that is NaN or infinite.
    #[error("its pose on the rig is not finite")]
    OdometryNotFinite,
    /// Every frame has too few correspondences; at least one frame must have enough.
    #[error(
        "none of the {frames} frames has enough correspondences for a pose of its own (on both sides of the dividing \
         line, where there is one); one such frame is needed, which the others then help"
    )]
    NoFrameAlone {
        /// How many frames there were.
        frames: usize,
    },
    /// The score cannot weigh frames against each other.
    #[error("the pose of a rig is estimated with the likelihood only; do not set the score")]
    ScoreOfRig,
    /// All lines belong to one anchor: the position along that anchor's ray is undetermined.
    #[error(
        "all {lines} lines run through the same anchor, so the camera's position along its ray is undetermined; \
         move or turn the camera so that keypoints lie on both sides of the dividing line"
    )]
    OneSided {
        /// How many lines there were.
        lines: usize,
    },
    /// The best pose agrees with the correspondences no better than a wrong pose would.
    #[error(
        "the best pose explains the correspondences no better than chance does (log evidence {log_evidence:.0})"
    )]
    Chance {
        /// [`crate::Confidence::log_evidence`].
        log_evidence: f64,
    },
    /// The search was stopped by [`crate::PoseOptions::stop`].
    #[error("the search was stopped before its end")]
    Stopped,
    /// No hypothesis has enough agreeing keypoints.
    #[error(
        "no pose is supported by the correspondences: the best of {hypotheses} hypotheses has {inliers} inliers, \
         {required} are the least"
    )]
    NoConsensus {
        /// Keypoints that agree with the best pose; 0 when no sample gave a pose.
        inliers: usize,
        /// Required number of keypoints.
        required: usize,
        /// Samples drawn.
        hypotheses: usize,
    },
}
