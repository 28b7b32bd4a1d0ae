//! Calibrates an estimate for a map: its covariance by the self-test of the map, and its state.

use veiloc_map::{CovarianceCalibration, MapFile};
use veiloc_pose::likelihood::GravityTest;
use veiloc_pose::{Confidence, PoseError, Precision, State};
use veiloc_protocol::Scheme;

use crate::error::LocalizeError;

/// An estimate as returned by the estimator; both covariances are in the chart of the pose.
pub(crate) struct RawEstimate<'a> {
    pub(crate) covariance: &'a [[f64; 6]; 6],
    pub(crate) by_matches: &'a [[f64; 6]; 6],
    /// The part of both that comes from the camera model.
    pub(crate) camera: &'a [[f64; 6]; 6],
    pub(crate) confidence: Confidence,
    pub(crate) gravity_test: Option<GravityTest>,
}

/// The calibrated estimate.
pub(crate) struct CalibratedEstimate {
    pub(crate) covariance: [[f64; 6]; 6],
    pub(crate) confidence: Confidence,
    pub(crate) state: State,
}

impl RawEstimate<'_> {
    /// Calibrates an estimate from this number of correspondences under a scheme, for a caller with this need.
    ///
    /// # Errors
    /// [`LocalizeError::NoPose`]: the pose explains the correspondences no better than chance.
    pub(crate) fn calibrate(
        &self,
        map: &MapFile,
        scheme: Scheme,
        correspondences: usize,
        need: Precision,
    ) -> Result<CalibratedEstimate, LocalizeError> {
        let calibration = map.self_test().and_then(|test| test.of_scheme(scheme)).map_or_else(
            || CovarianceCalibration::unmeasured(self.confidence.distance),
            |test| test.calibration,
        );
        let covariance = calibration.apply(self.covariance, self.camera);
        let by_matches = calibration.apply(self.by_matches, self.camera);
        let mut confidence = self.confidence.with_covariances(&covariance, &by_matches);
        confidence.gravity = self.gravity_test.map(|test| test.judge(&by_matches));
        confidence.needed = need;
        let state = confidence.state();
        if state == State::NotFound {
            let source = PoseError::Chance { log_evidence: confidence.log_evidence };
            return Err(LocalizeError::NoPose { source, correspondences });
        }
        Ok(CalibratedEstimate { covariance, confidence, state })
    }
}
