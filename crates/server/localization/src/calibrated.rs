//! What an estimate is worth in this map: its covariance calibrated by the map's self-test, and its state.

use veiloc_map::{Calibration, MapFile};
use veiloc_pose::{Confidence, PoseError, State};
use veiloc_protocol::Scheme;

use crate::error::LocalizeError;

/// The estimator's own covariances, both in the chart of the pose.
pub(crate) struct Own<'a> {
    pub(crate) covariance: &'a [[f64; 6]; 6],
    pub(crate) by_matches: &'a [[f64; 6]; 6],
    pub(crate) confidence: Confidence,
}

/// The same as it is answered.
pub(crate) struct Verdict {
    pub(crate) covariance: [[f64; 6]; 6],
    pub(crate) confidence: Confidence,
    pub(crate) state: State,
}

impl Own<'_> {
    /// Of an estimate from so many correspondences under a scheme.
    ///
    /// # Errors
    /// [`LocalizeError::NoPose`] for one that explains them no better than chance does.
    pub(crate) fn in_map(
        &self,
        map: &MapFile,
        scheme: Scheme,
        correspondences: usize,
    ) -> Result<Verdict, LocalizeError> {
        let calibration = map
            .self_test()
            .and_then(|test| test.of_scheme(scheme))
            .map_or_else(|| Calibration::unmeasured(self.confidence.distance), |test| test.calibration);
        let covariance = calibration.apply(self.covariance);
        let confidence = self.confidence.with_covariances(&covariance, &calibration.apply(self.by_matches));
        let state = confidence.state();
        if state == State::NotFound {
            let source = PoseError::Chance { log_evidence: confidence.log_evidence };
            return Err(LocalizeError::NoPose { source, correspondences });
        }
        Ok(Verdict { covariance, confidence, state })
    }
}
