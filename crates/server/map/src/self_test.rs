//! How well a map localizes its own images, and what follows for the covariances of its answers.
//!
//! A self-test localizes images of the map as if they were queries, each left out of the map meanwhile. Its poses are
//! compared with those that the map was built with. It is run by `veiloc_mapping::calibration`; here is what it came to, because it is
//! kept in the map's file and used where queries are answered.

use veiloc_protocol::Scheme;

/// Shares of [`SelfTest::scale`] and degrees within which poses are counted, whatever the map's unit is.
pub const RELATIVE: [(f64, f64); 3] = [(0.002, 0.2), (0.01, 1.0), (0.05, 5.0)];

/// Map units and degrees within which poses are counted, for maps in metres.
pub const ABSOLUTE: [(f64, f64); 2] = [(0.05, 5.0), (0.25, 2.0)];

/// Probabilities of the regions whose coverage is counted.
pub const LEVELS: [f64; 3] = [0.5, 0.9, 0.99];

/// What a map's test of itself came to.
#[derive(Debug, Clone, PartialEq)]
pub struct SelfTest {
    /// Images that were localized, each left out of the map meanwhile.
    pub images: u32,
    /// Median over the images of the median distance of what they see, map units; 0 when they see nothing.
    pub scale: f64,
    /// Noise of keypoints that the estimator assumes, pixels.
    pub assumed_noise_px: f64,
    /// One entry a scheme.
    pub schemes: Vec<SchemeTest>,
}

/// What a self-test came to under one scheme.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SchemeTest {
    /// Which one. The layout of `dcl` is the default one.
    pub scheme: Scheme,
    /// Images of which there was a pose.
    pub localized: u32,
    /// Images whose pose was trusted.
    pub trusted: u32,
    /// Images within each of [`RELATIVE`].
    pub within_of_scale: [u32; 3],
    /// Images within each of [`ABSOLUTE`].
    pub within: [u32; 2],
    /// Over all images, degrees; one that was not localized counts as infinite.
    pub median_rotation_deg: f64,
    /// Of the camera centre over all images, map units; one that was not localized counts as infinite.
    pub median_translation: f64,
    /// Of the noise that agreeing keypoints showed in trusted poses, pixels; 0 without any.
    pub median_noise_px: f64,
    /// Of trusted poses by the estimator's own covariances.
    pub before: Coverage,
    /// The same by calibrated covariances; each pose by a calibration that has not seen it.
    pub after: Coverage,
    /// What makes the estimator's covariances those of this map.
    pub calibration: Calibration,
}

/// Shares of trusted poses whose true pose lay within the region of each of [`LEVELS`]; 0 without any.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Coverage {
    /// Of the camera centre, three dimensions.
    pub center: [f64; 3],
    /// Of the pose, six dimensions.
    pub pose: [f64; 3],
}

/// From the estimator's covariance `C` to the one that is answered: `C' = a C + diag(s_r² I, s_t² I)`, in the chart of
/// [`CameraFromWorld::perturbed`](veiloc_geometry::CameraFromWorld::perturbed).
///
/// `C` knows the noise of the query's keypoints and of each map point. It does not know what all points of a query share:
/// errors of the poses and lenses that the map was made with. These do not become smaller with the number of matches, hence
/// the floors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// `a`, above 0.
    pub factor: f64,
    /// `s_r`, radians.
    pub rotation_floor: f64,
    /// `s_t`, map units.
    pub translation_floor: f64,
}

impl Calibration {
    /// Of a map without a self-test, and what maps with few images are drawn to; `distance` is the one of what the query
    /// sees, map units.
    ///
    /// Self-tests came to `a` of 12 and 3.1, `s_r` of 0.011° and 0.0013°, and `s_t` of 0.52 and 0.39 ten-thousandths of the
    /// distance (RedKitchen, whose poses are those of a depth camera's tracker, and Herz-Jesu; means over the schemes;
    /// `veiloc map build --json`, `self_test`). The default lies between the two in `a` and `s_r`, and above both in `s_t`: a
    /// map of good poses is told less sure than it is, one of poor poses more sure.
    pub fn unmeasured(distance: f64) -> Self {
        let distance = if distance.is_finite() { distance.max(0.0) } else { 0.0 };
        Self {
            factor: UNMEASURED_FACTOR,
            rotation_floor: UNMEASURED_ROTATION_DEG.to_radians(),
            translation_floor: UNMEASURED_SHARE * distance,
        }
    }

    /// The covariance that is answered. What is infinite stays so.
    pub fn apply(&self, covariance: &[[f64; 6]; 6]) -> [[f64; 6]; 6] {
        let floor = |i: usize| if i < 3 { self.rotation_floor } else { self.translation_floor }.powi(2);
        std::array::from_fn(|i| {
            std::array::from_fn(|j| self.factor * covariance[i][j] + if i == j { floor(i) } else { 0.0 })
        })
    }

    fn check(&self) -> Result<(), String> {
        let possible = self.factor.is_finite()
            && self.factor > 0.0
            && [self.rotation_floor, self.translation_floor].iter().all(|f| f.is_finite() && *f >= 0.0);
        if possible { Ok(()) } else { Err("a calibration that no covariance can take".to_owned()) }
    }
}

impl SelfTest {
    /// What came of a scheme; layouts of `dcl` are taken for one.
    pub fn of_scheme(&self, scheme: Scheme) -> Option<&SchemeTest> {
        self.schemes.iter().find(|s| s.scheme.name() == scheme.name())
    }

    /// Whether next to none of the images was localized: fewer than one in ten within the widest of [`RELATIVE`] under
    /// any scheme.
    pub fn failed(&self) -> bool {
        let best = self.schemes.iter().map(|s| s.within_of_scale[2]).max().unwrap_or(0);
        10 * best < self.images
    }

    /// Refuses what no self-test can come to.
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
        self.calibration.check()
    }
}

/// `a` of a map without a self-test.
const UNMEASURED_FACTOR: f64 = 5.0;
/// `s_r` of a map without a self-test, degrees.
const UNMEASURED_ROTATION_DEG: f64 = 0.005;
/// `s_t` of a map without a self-test, as a share of the distance of what is seen.
const UNMEASURED_SHARE: f64 = 0.000_1;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_calibration_scales_and_adds_and_keeps_the_infinite() {
        let calibration = Calibration { factor: 2.0, rotation_floor: 0.1, translation_floor: 3.0 };
        let mut covariance = [[0.5; 6]; 6];
        covariance[5][5] = f64::INFINITY;
        let applied = calibration.apply(&covariance);
        assert!((applied[0][0] - 1.01).abs() < 1e-12 && (applied[3][3] - 10.0).abs() < 1e-12);
        assert_eq!((applied[0][3], applied[5][4], applied[5][5]), (1.0, 1.0, f64::INFINITY));
    }

    #[test]
    fn a_map_without_a_test_is_calibrated_by_the_distance_of_what_is_seen() {
        let (near, far) = (Calibration::unmeasured(1.0), Calibration::unmeasured(10.0));
        assert!((far.translation_floor / near.translation_floor - 10.0).abs() < 1e-9);
        assert!(near.factor >= 1.0 && near.rotation_floor > 0.0);
        for odd in [f64::NAN, f64::INFINITY, -1.0] {
            assert_eq!(Calibration::unmeasured(odd).translation_floor, 0.0);
        }
    }
}
