//! Why a query was not localized.

use veiloc_pose::PoseError;
use veiloc_protocol::QueryError;

/// Why there is no pose.
///
/// No message contains any content of the query (leak L8).
#[derive(Debug, thiserror::Error)]
pub enum LocalizeError {
    /// The query was sealed for another map, or with an outdated profile or pack.
    #[error(
        "{source}; export this map's profile with `veiloc map profile`, or its pack with `veiloc map pack`, and seal with \
         it another image, taken at least one step away"
    )]
    WrongProfile {
        /// The profile or pack of the query, and the expected one.
        source: QueryError,
    },
    /// The map has no image or no point.
    #[error("the map is empty; add posed images with `veiloc map add`")]
    EmptyMap,
    /// A query of a session cannot be used.
    #[error("frame {frame}: {source}")]
    Frame {
        /// Index of the frame, from 0.
        frame: usize,
        /// The reason.
        source: Box<LocalizeError>,
    },
    /// Localization was cancelled: [`veiloc_pose::PoseOptions::stop`].
    #[error("localization was stopped before its end")]
    Stopped,
    /// The robust estimator found no pose.
    #[error("not localized: {source}")]
    NoPose {
        /// The error of the estimator.
        source: PoseError,
        /// Number of correspondences.
        correspondences: usize,
    },
}

impl LocalizeError {
    /// Converts an error of the estimator; `correspondences`: their number.
    pub(crate) fn of_pose(source: PoseError, correspondences: usize) -> Self {
        match source {
            PoseError::Stopped => Self::Stopped,
            source => Self::NoPose { source, correspondences },
        }
    }
}
