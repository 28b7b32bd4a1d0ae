//! Summarizes the trials of a scheme.

use veiloc_geometry::statistics::upper_median;
use veiloc_map::{ABSOLUTE, CameraErrors, ConfidenceCoverage, CovarianceCalibration, RELATIVE, SchemeTest};
use veiloc_pose::likelihood::{CameraEvidence, MapCameras};
use veiloc_protocol::Scheme;

use crate::calibration::fit::fit;
use crate::calibration::radii::{SQUARED_RADII_3, SQUARED_RADII_6};
use crate::calibration::trial::{Distances, SelfTestTrial};

/// Summarizes all tested images; `None` marks an image without pose. If parts of the map look alike, poses far from the
/// true ones do not calibrate covariances: they are in the other part, at any distance.
pub(crate) fn summarize(
    scheme: Scheme,
    trials: &[Option<SelfTestTrial>],
    scale: f64,
    parts_look_alike: bool,
) -> SchemeTest {
    let found: Vec<SelfTestTrial> = trials.iter().flatten().cloned().collect();
    let is_elsewhere = |t: &SelfTestTrial| parts_look_alike && t.translation() > RELATIVE[2].0 * scale;
    let calibrates = |t: &&SelfTestTrial| t.is_usable() && !is_elsewhere(t);
    let trusted: Vec<SelfTestTrial> = found.iter().filter(calibrates).cloned().collect();
    let within = |translation: f64, degrees: f64| {
        found.iter().filter(|t| t.translation() <= translation && t.rotation_deg() <= degrees).count() as u32
    };
    let of_all = |of: fn(&SelfTestTrial) -> f64| {
        median(trials.iter().map(|t| t.as_ref().map_or(f64::INFINITY, of)).collect())
    };
    let noise = median(trusted.iter().map(|t| t.noise_px).collect());
    SchemeTest {
        scheme,
        localized: found.len() as u32,
        trusted: found.iter().filter(|t| t.trusted).count() as u32,
        within_of_scale: RELATIVE.map(|(share, degrees)| within(share * scale, degrees)),
        within: ABSOLUTE.map(|(units, degrees)| within(units, degrees)),
        median_rotation_deg: of_all(SelfTestTrial::rotation_deg),
        median_translation: of_all(SelfTestTrial::translation),
        median_noise_px: if noise.is_finite() { noise } else { 0.0 },
        before: coverage(trusted.iter().map(|t| t.squared_distances(&AS_ESTIMATED))),
        after: coverage(cross_validated(&trusted, scale).into_iter()),
        calibration: fit(&trusted, scale),
        cameras: camera_errors(&trusted),
    }
}

fn camera_errors(trusted: &[SelfTestTrial]) -> CameraErrors {
    let evidence: Vec<CameraEvidence> = trusted.iter().filter_map(|trial| trial.camera_evidence).collect();
    let MapCameras { sd, min_log_odds, min_focal_gain } = MapCameras::fit(&evidence);
    CameraErrors { sd, min_log_odds, min_focal_gain }
}

/// The estimator's own covariances.
const AS_ESTIMATED: CovarianceCalibration =
    CovarianceCalibration { factor: 1.0, rotation_floor: 0.0, translation_floor: 0.0 };

/// Cross-validation: each trial under a calibration fitted to the other four fifths.
fn cross_validated(trials: &[SelfTestTrial], scale: f64) -> Vec<Option<Distances>> {
    let mut distances = vec![None; trials.len()];
    for part in 0..PARTS {
        let others: Vec<SelfTestTrial> =
            trials.iter().enumerate().filter(|(i, _)| i % PARTS != part).map(|(_, t)| t.clone()).collect();
        let calibration = fit(&others, scale);
        for i in (part..trials.len()).step_by(PARTS) {
            distances[i] = trials[i].squared_distances(&calibration);
        }
    }
    distances
}

fn coverage(distances: impl Iterator<Item = Option<Distances>>) -> ConfidenceCoverage {
    let distances: Vec<Distances> = distances.flatten().collect();
    let share = |of: fn(&Distances) -> f64, radius: f64| {
        distances.iter().filter(|d| of(d) <= radius).count() as f64 / distances.len().max(1) as f64
    };
    ConfidenceCoverage {
        center: SQUARED_RADII_3.map(|radius| share(|d| d.center, radius)),
        pose: SQUARED_RADII_6.map(|radius| share(|d| d.pose, radius)),
    }
}

/// Upper median; infinite for an empty list.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    upper_median(&mut values).unwrap_or(f64::INFINITY)
}

/// Parts of the trials in cross-validation.
const PARTS: usize = 5;
