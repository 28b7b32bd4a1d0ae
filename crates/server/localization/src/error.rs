//! Why a query was not localized.

use veiloc_pose::PoseError;
use veiloc_protocol::QueryError;

/// Why there is no pose.
///
/// None of the messages holds anything of the query's content (leak L8).
#[derive(Debug, thiserror::Error)]
pub enum LocalizeError {
    /// The query was sealed for another map, or for an older state of this one's profile.
    #[error(
        "{source}; export this map's profile again with `veiloc map profile`, move on, and seal an image from there with it"
    )]
    WrongProfile {
        /// Which profile was found, and which expected.
        source: QueryError,
    },
    /// The map holds no image or no point.
    #[error("the map is empty; add posed images with `veiloc map add`")]
    EmptyMap,
    /// A query of a session cannot be used.
    #[error("frame {frame}: {source}")]
    Frame {
        /// Which, from 0.
        frame: usize,
        /// What is wrong with it.
        source: Box<LocalizeError>,
    },
    /// It was given up before its end: [`veiloc_pose::PoseOptions::stop`].
    #[error("localization was stopped before its end")]
    Stopped,
    /// The robust estimator found no pose.
    #[error("not localized: {source}")]
    NoPose {
        /// What the estimator said.
        source: PoseError,
        /// How many correspondences it had.
        correspondences: usize,
    },
}

impl LocalizeError {
    /// What the estimator said, told of so many correspondences.
    pub(crate) fn of_pose(source: PoseError, correspondences: usize) -> Self {
        match source {
            PoseError::Stopped => Self::Stopped,
            source => Self::NoPose { source, correspondences },
        }
    }
}
