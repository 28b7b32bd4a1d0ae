//! What a problem can be refused for, with the facts.

/// Why no pose can be estimated from a problem.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ProblemError {
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
    /// The camera or what is known of the pose has an impossible value.
    #[error("{what} is {value}, which is not possible")]
    BadValue {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
    },
}
