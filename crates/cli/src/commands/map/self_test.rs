//! The self-test at the end of a build or a change, and its output.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use veiloc_evaluation::results::text_table::TextTable;
use veiloc_map::{ABSOLUTE, ConfidenceCoverage, LEVELS, MapModel, RELATIVE, SchemeTest, SelfTest};
use veiloc_mapping::{FinishOptions, MapWarning, MappingError, finish, refuse_broken_compressed};
use veiloc_report::significant;

use crate::output::exit::Failure;
use crate::output::stages::Stages;
use crate::output::ui::Ui;

/// How the map is finished.
#[derive(clap::Args)]
pub(super) struct FinishArgs {
    /// Do not localize the map's own images at the end: no recall, and covariances calibrated with those of other maps.
    #[arg(long)]
    no_self_test: bool,
    /// Write the map even if nothing can be localized in it.
    #[arg(long)]
    keep_broken: bool,
}

impl FinishArgs {
    /// Tests the map, stores the result in it, and adds the warnings that follow from it. A map in which nothing can be
    /// localized is refused, so that it does not replace a usable one.
    pub(super) fn finish(
        &self,
        model: &mut MapModel,
        warnings: &mut Vec<MapWarning>,
        out: &Path,
        ui: &Ui,
    ) -> Result<(), Failure> {
        let options = FinishOptions { self_test: !self.no_self_test, keep_broken: self.keep_broken };
        finish(model, warnings, &options, &Stages::new(ui)).map_err(|error| refused(error, out, ui))
    }

    /// Whether the map is tested.
    pub(super) const fn is_tested(&self) -> bool {
        !self.no_self_test
    }

    /// Refuses a compressed map in which nothing can be localized.
    pub(super) fn check_compressed(
        &self,
        whole: &MapModel,
        compressed: &MapModel,
        out: &Path,
        ui: &Ui,
    ) -> Result<(), Failure> {
        if self.keep_broken {
            return Ok(());
        }
        refuse_broken_compressed(whole, compressed).map_err(|error| refused(error, out, ui))
    }
}

fn refused(error: MappingError, out: &Path, ui: &Ui) -> Failure {
    let MappingError::Broken { points, warnings } = error else { return error.into() };
    for warning in &warnings {
        ui.warning(warning);
    }
    Failure::with_help(
        format!("{}: not written: nothing can be localized in this map of {points} points", out.display()),
        "fix the problems that the warnings name, or write the map anyway with --keep-broken",
    )
}

/// A self-test as JSON.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct SelfTestInfo {
    /// Number of localized images, each left out of the map meanwhile.
    images: u32,
    /// Median over the images of their median distance to the observed points, map units.
    scale: f64,
    /// Assumed noise of keypoints, pixels.
    assumed_noise_px: f64,
    /// One entry per obfuscation scheme.
    schemes: Vec<SchemeInfo>,
}

/// Self-test under one obfuscation scheme.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct SchemeInfo {
    /// Obfuscation scheme.
    scheme: &'static str,
    /// Number of images with a pose.
    localized: u32,
    /// Number of images with a trusted pose.
    trusted: u32,
    /// Threshold (`translation/degrees`) to share of images within it.
    recall: BTreeMap<String, f64>,
    /// The same with the translation as a share of `scale`, for maps whose unit is not the metre.
    relative_recall: BTreeMap<String, f64>,
    /// Median orientation error over all images, degrees; null when half of them or more were not localized.
    median_rotation_deg: Option<f64>,
    /// Median error of the camera centre over all images, map units; null when half of them or more were not
    /// localized.
    median_translation: Option<f64>,
    /// Median of the estimated noise of inliers, over trusted poses, pixels.
    noise_px: f64,
    /// Coverage of covariances, before and after calibration.
    coverage: BeforeAfter,
    /// Calibration of the covariances of answers.
    calibration: CalibrationInfo,
    /// Errors of the cameras of its images, as the images themselves show them.
    cameras: CameraInfo,
}

/// Coverage before and after calibration.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct BeforeAfter {
    /// With the estimator's covariances.
    before: CoverageInfo,
    /// With covariances that were calibrated without the image itself.
    after: CoverageInfo,
}

/// Coverage of covariances.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct CoverageInfo {
    /// Percentage of the confidence region to share of true camera centres in it, over trusted poses.
    center: BTreeMap<String, f64>,
    /// The same for whole poses.
    pose: BTreeMap<String, f64>,
}

/// Calibration of covariances.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct CalibrationInfo {
    /// Factor of the covariance.
    factor: f64,
    /// Standard deviation whose square is then added to each variance of the rotation, degrees.
    rotation_floor_deg: f64,
    /// The same for the translation, map units.
    translation_floor: f64,
}

/// Errors of the map's own cameras.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct CameraInfo {
    /// Standard deviations: logarithm of the focal length, logarithm of `fx / fy`, skew, principal point along both axes
    /// (shares of the image's width), first radial term.
    sd: [f64; 6],
    /// Logarithm of the odds from which on the camera of a query is called wrong.
    min_log_odds: f64,
    /// Gain in log likelihood of another focal length from which on that of a query is doubted.
    min_focal_gain: f64,
}

impl SelfTestInfo {
    pub(super) fn of(test: &SelfTest) -> Self {
        Self {
            images: test.images,
            scale: test.scale,
            assumed_noise_px: test.assumed_noise_px,
            schemes: test.schemes.iter().map(|s| SchemeInfo::of(s, test.images)).collect(),
        }
    }

    /// Text output: a table with one line per scheme, and the meaning of its columns.
    pub(super) fn describe(&self, unit: &str) -> String {
        let head = [
            "scheme",
            "localized",
            "trusted",
            "within 1 %",
            "median error",
            "noise",
            "in 90 % region",
            "± times",
            "least ±",
        ];
        let mut table = TextTable::new(head, 1);
        self.schemes.iter().for_each(|scheme| table.push(scheme.cells()));
        let lines = table.render();
        let lines: String = lines.lines().flat_map(|line| ["    ", line, "\n"]).collect();
        format!(
            "  self-test   {} images, each left out of the map; typical distance to the scene {} {unit}\n{lines}\
             \x20   Within 1 %: position error below 1 % of that distance, and rotation error below 1°. Median error: {unit}, \
             degrees.\n    In 90 % region: share of the true poses, before → after the calibration. The calibration multiplies \
             each\n    ± of a position by \"± times\", and none is below \"least ±\" ({unit}).\n",
            self.images,
            significant(self.scale),
        )
    }
}

impl SchemeInfo {
    fn of(test: &SchemeTest, images: u32) -> Self {
        let share = |count: &u32| f64::from(*count) / f64::from(images.max(1));
        Self {
            scheme: test.scheme.name(),
            localized: test.localized,
            trusted: test.trusted,
            recall: ABSOLUTE.map(key).into_iter().zip(test.within.iter().map(share)).collect(),
            relative_recall: RELATIVE
                .map(key)
                .into_iter()
                .zip(test.within_of_scale.iter().map(share))
                .collect(),
            median_rotation_deg: finite(test.median_rotation_deg),
            median_translation: finite(test.median_translation),
            noise_px: test.median_noise_px,
            coverage: BeforeAfter { before: coverage(&test.before), after: coverage(&test.after) },
            calibration: CalibrationInfo {
                factor: test.calibration.factor,
                rotation_floor_deg: test.calibration.rotation_floor.to_degrees(),
                translation_floor: test.calibration.translation_floor,
            },
            cameras: CameraInfo {
                sd: test.cameras.sd,
                min_log_odds: test.cameras.min_log_odds,
                min_focal_gain: test.cameras.min_focal_gain,
            },
        }
    }
}

impl SchemeInfo {
    /// The cells of its line of text: the shares of true poses in the 90 % confidence region, by the estimator's
    /// covariances and after calibration.
    fn cells(&self) -> Vec<String> {
        let error = match (self.median_translation, self.median_rotation_deg) {
            (Some(t), Some(r)) => format!("{}, {}°", significant(t), significant(r)),
            _ => "infinite".to_owned(),
        };
        let percent_of =
            |shares: &BTreeMap<String, f64>, key: String| 100.0 * shares.get(&key).copied().unwrap_or(0.0);
        let level = || percent(LEVELS[1]);
        vec![
            self.scheme.to_owned(),
            self.localized.to_string(),
            self.trusted.to_string(),
            format!("{:.0} %", percent_of(&self.relative_recall, key(RELATIVE[1]))),
            error,
            format!("{:.1} px", self.noise_px),
            format!(
                "{:.0} → {:.0} %",
                percent_of(&self.coverage.before.pose, level()),
                percent_of(&self.coverage.after.pose, level())
            ),
            significant(self.calibration.factor.sqrt()),
            significant(self.calibration.translation_floor),
        ]
    }
}

fn coverage(coverage: &ConfidenceCoverage) -> CoverageInfo {
    let levels = |shares: [f64; LEVELS.len()]| LEVELS.map(percent).into_iter().zip(shares).collect();
    CoverageInfo { center: levels(coverage.center), pose: levels(coverage.pose) }
}

/// `translation/degrees`, as in all thresholds.
fn key((translation, degrees): (f64, f64)) -> String {
    format!("{translation}/{degrees}")
}

fn percent(level: f64) -> String {
    format!("{}", (100.0 * level).round())
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}
