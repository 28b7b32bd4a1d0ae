//! Self-test of a map: how well it localizes its own images, and the resulting calibration of covariances.
//!
//! A self-test localizes images of the map as queries, each left out of the map meanwhile, and compares the poses
//! with those of the map. `veiloc_mapping::calibration` runs it; the results are stored in the map file and used by
//! the server.

use veiloc_protocol::Scheme;

/// Thresholds: shares of [`SelfTest::scale`], and degrees; independent of the map unit.
pub const RELATIVE: [(f64, f64); 3] = [(0.002, 0.2), (0.01, 1.0), (0.05, 5.0)];

/// Thresholds: map units and degrees, for maps in metres.
pub const ABSOLUTE: [(f64, f64); 2] = [(0.05, 5.0), (0.25, 2.0)];

/// Probabilities of the confidence regions whose coverage is measured.
pub const LEVELS: [f64; 3] = [0.5, 0.9, 0.99];

/// Result of a self-test.
#[derive(Debug, Clone, PartialEq)]
pub struct SelfTest {
    /// Number of test images, each left out of the map meanwhile.
    pub images: u32,
    /// Median over the images of the median depth of their points, map units; 0 without points.
    pub scale: f64,
    /// Keypoint noise that the estimator assumes, pixels.
    pub assumed_noise_px: f64,
    /// One entry per scheme.
    pub schemes: Vec<SchemeTest>,
}

/// Result of a self-test for one scheme.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SchemeTest {
    /// The scheme; `dcl` with its default layout.
    pub scheme: Scheme,
    /// Number of localized images.
    pub localized: u32,
    /// Number of images with a trusted pose.
    pub trusted: u32,
    /// Number of images within each of [`RELATIVE`].
    pub within_of_scale: [u32; 3],
    /// Number of images within each of [`ABSOLUTE`].
    pub within: [u32; 2],
    /// Median rotation error, degrees; images without a pose count as infinite.
    pub median_rotation_deg: f64,
    /// Median error of the camera centre, map units; images without a pose count as infinite.
    pub median_translation: f64,
    /// Median noise of inliers in trusted poses, pixels; 0 without any.
    pub median_noise_px: f64,
    /// Coverage of trusted poses by the covariances of the estimator.
    pub before: ConfidenceCoverage,
    /// The same by calibrated covariances; each pose by a calibration that did not use it.
    pub after: ConfidenceCoverage,
    /// Calibration of the covariances for this map.
    pub calibration: CovarianceCalibration,
    /// How much the cameras of the images differ from the true ones.
    pub cameras: CameraErrors,
}

/// Errors of a map's cameras, as its own images show them. `veiloc_pose::likelihood::MapCameras` explains the numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraErrors {
    /// Standard deviations, above 0: logarithm of the focal length, logarithm of `fx / fy`, skew, shift of the principal
    /// point along both axes as shares of the image's width, first radial term.
    pub sd: [f64; 6],
    /// Logarithm of the odds from which on the camera of a query is wrong.
    pub min_log_odds: f64,
    /// Gain in log likelihood of another focal length from which on it speaks against that of a query; not below 0.
    pub min_focal_gain: f64,
}

/// Shares of trusted poses whose true pose was within the confidence region of each of [`LEVELS`]; 0 without any.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ConfidenceCoverage {
    /// Coverage of the camera centre, three dimensions.
    pub center: [f64; 3],
    /// Coverage of the pose, six dimensions.
    pub pose: [f64; 3],
}

/// Maps the covariance `C` of the estimator to the reported one: `C' = a (C − C_camera) + C_camera + diag(s_r² I, s_t² I)`,
/// in the chart of
/// [`CameraFromWorld::perturbed`](veiloc_geometry::CameraFromWorld::perturbed).
///
/// `C` covers the noise of the keypoints of the query and of each map point. It does not cover errors that all points
/// of a query share: those of poses and intrinsics of the map. These do not decrease with the number of matches,
/// hence the floors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CovarianceCalibration {
    /// `a`, above 0.
    pub factor: f64,
    /// `s_r`, radians.
    pub rotation_floor: f64,
    /// `s_t`, map units.
    pub translation_floor: f64,
}

impl CovarianceCalibration {
    /// Default for maps without a self-test, and prior for maps with few images; `distance` is the distance of the
    /// observed scene, map units.
    ///
    /// Self-tests of seven places gave `a` of 0.9 to 3.3, and of 7.6 for `dcl` where images are blurred and the shutter
    /// rolls (`veiloc map build --json`, `self_test`). For a map with accurate poses the reported covariance is too large,
    /// for one with inaccurate poses too small.
    pub fn unmeasured(distance: f64) -> Self {
        let distance = if distance.is_finite() { distance.max(0.0) } else { 0.0 };
        Self {
            factor: UNMEASURED_FACTOR,
            rotation_floor: UNMEASURED_ROTATION_DEG.to_radians(),
            translation_floor: UNMEASURED_SHARE * distance,
        }
    }

    /// The reported covariance: `camera` is the part of it that comes from the query's camera model, which a self-test
    /// with the map's own cameras says nothing about. Infinite entries stay infinite.
    pub fn apply(&self, covariance: &[[f64; 6]; 6], camera: &[[f64; 6]; 6]) -> [[f64; 6]; 6] {
        let floor = |i: usize| if i < 3 { self.rotation_floor } else { self.translation_floor }.powi(2);
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let own = covariance[i][j] - camera[i][j];
                self.factor * own + camera[i][j] + if i == j { floor(i) } else { 0.0 }
            })
        })
    }

    fn check(&self) -> Result<(), String> {
        let possible = self.factor.is_finite()
            && self.factor > 0.0
            && [self.rotation_floor, self.translation_floor].iter().all(|f| f.is_finite() && *f >= 0.0);
        if possible { Ok(()) } else { Err("an invalid calibration".to_owned()) }
    }
}

impl SelfTest {
    /// The result for a scheme; all layouts of `dcl` share one.
    pub fn of_scheme(&self, scheme: Scheme) -> Option<&SchemeTest> {
        self.schemes.iter().find(|s| s.scheme.name() == scheme.name())
    }

    /// Whether almost no image was localized: fewer than one in ten within the widest of [`RELATIVE`] under any
    /// scheme.
    pub fn failed(&self) -> bool {
        let best = self.schemes.iter().map(|s| s.within_of_scale[2]).max().unwrap_or(0);
        10 * best < self.images
    }

    /// Checks that the values are possible.
    pub(crate) fn check(&self) -> Result<(), String> {
        if !(self.scale.is_finite() && self.scale >= 0.0) {
            return Err(format!("a scale of {}", self.scale));
        }
        if !(self.assumed_noise_px.is_finite() && self.assumed_noise_px >= 0.0) {
            return Err(format!("an assumed noise of {} px", self.assumed_noise_px));
        }
        for (i, scheme) in self.schemes.iter().enumerate() {
            if self.schemes[..i].iter().any(|s| s.scheme.name() == scheme.scheme.name()) {
                return Err(format!("scheme {} appears twice", scheme.scheme.name()));
            }
            scheme.check(self.images).map_err(|e| format!("scheme {}: {e}", scheme.scheme.name()))?;
        }
        Ok(())
    }
}

impl SchemeTest {
    fn check(&self, images: u32) -> Result<(), String> {
        let counts = self.within_of_scale.iter().chain(&self.within).chain([&self.localized, &self.trusted]);
        if let Some(count) = counts.into_iter().find(|c| **c > images) {
            return Err(format!("{count} of {images} images"));
        }
        let medians = [self.median_rotation_deg, self.median_translation, self.median_noise_px];
        if let Some(median) = medians.iter().find(|m| m.is_nan() || **m < 0.0) {
            return Err(format!("a median of {median}"));
        }
        let shares = [self.before, self.after].map(|c| [c.center, c.pose]);
        if let Some(share) = shares.iter().flatten().flatten().find(|s| !(0.0..=1.0).contains(*s)) {
            return Err(format!("a coverage of {share}"));
        }
        let cameras = &self.cameras;
        let is_gain = cameras.min_focal_gain.is_finite() && cameras.min_focal_gain >= 0.0;
        let is_sd = |sd: &f64| sd.is_finite() && *sd > 0.0;
        if !(cameras.sd.iter().all(is_sd) && cameras.min_log_odds.is_finite() && is_gain) {
            return Err("invalid errors of cameras".to_owned());
        }
        self.calibration.check()
    }
}

/// `a` of a map without a self-test.
const UNMEASURED_FACTOR: f64 = 2.0;
/// `s_r` of a map without a self-test, degrees.
const UNMEASURED_ROTATION_DEG: f64 = 0.005;
/// `s_t` of a map without a self-test, as a share of the distance.
const UNMEASURED_SHARE: f64 = 0.000_1;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calibration_scales_and_adds_floors() {
        let calibration = CovarianceCalibration { factor: 2.0, rotation_floor: 0.1, translation_floor: 3.0 };
        let mut covariance = [[0.5; 6]; 6];
        covariance[5][5] = f64::INFINITY;
        let applied = calibration.apply(&covariance, &[[0.0; 6]; 6]);
        assert!((applied[0][0] - 1.01).abs() < 1e-12 && (applied[3][3] - 10.0).abs() < 1e-12);
        assert_eq!((applied[0][3], applied[5][4], applied[5][5]), (1.0, 1.0, f64::INFINITY));
    }

    #[test]
    fn default_calibration_depends_on_the_distance() {
        let (near, far) = (CovarianceCalibration::unmeasured(1.0), CovarianceCalibration::unmeasured(10.0));
        assert!((far.translation_floor / near.translation_floor - 10.0).abs() < 1e-9);
        assert!(near.factor >= 1.0 && near.rotation_floor > 0.0);
        for odd in [f64::NAN, f64::INFINITY, -1.0] {
            assert_eq!(CovarianceCalibration::unmeasured(odd).translation_floor, 0.0);
        }
    }
}
