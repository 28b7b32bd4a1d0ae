//! The self-test at the end of a build or a change, and its output.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use veiloc_evaluation::results::text_table::TextTable;
use veiloc_map::{ABSOLUTE, Coverage, LEVELS, MapModel, RELATIVE, SchemeTest, SelfTest};
use veiloc_mapping::calibration::{SelfTestOptions, is_testable, self_test};
use veiloc_mapping::{Doubt, diagnose};
use veiloc_report::significant;

use crate::exit::Failure;
use crate::stages::Stages;
use crate::ui::Ui;

/// Whether the map is tested.
#[derive(clap::Args)]
pub(super) struct SelfTestArgs {
    /// Do not localize the map's own images at the end: no recall, and covariances calibrated with those of other maps.
    #[arg(long)]
    no_self_test: bool,
}

impl SelfTestArgs {
    /// Tests the map, stores the result in it, and adds the warnings that follow from it.
    pub(super) fn test(
        &self,
        model: &mut MapModel,
        warnings: &mut Vec<MapWarning>,
        ui: &Ui,
    ) -> Result<(), Failure> {
        model.self_test = None;
        if self.no_self_test || !is_testable(model) {
            return Ok(());
        }
        let test = self_test(model, &SelfTestOptions::default(), &Stages::new(ui))?;
        if let Some(warning) = MapWarning::of_self_test(&test) {
            warnings.push(warning);
            if !warnings.iter().any(|d| matches!(d, MapWarning::LikelyCause { .. })) {
                warnings.extend(diagnose(model));
            }
        }
        model.self_test = Some(test);
        Ok(())
    }
}

/// Whether an unusable map is written.
#[derive(clap::Args)]
pub(super) struct KeepBrokenArgs {
    /// Write the map even if nothing can be localized in it.
    #[arg(long)]
    keep_broken: bool,
}

impl KeepBrokenArgs {
    /// Refuses a map in which nothing can be localized, so that it does not replace a usable one.
    pub(super) fn allow(
        &self,
        model: &MapModel,
        warnings: &[MapWarning],
        out: &Path,
        ui: &Ui,
    ) -> Result<(), Failure> {
        if self.keep_broken || !is_broken(model, warnings) {
            return Ok(());
        }
        for doubt in doubts {
            ui.warning(doubt);
        }
        Err(Failure::with_help(
            format!(
                "{}: not written: nothing can be localized in this map of {} points",
                out.display(),
                model.points.len()
            ),
            "fix the problems that the warnings name, or write the map anyway with --keep-broken",
        ))
    }
}

/// Detects a map with almost no points, or one that localizes few of its own images for a known reason. A low share
/// alone proves nothing: if images are sparse, each left-out image may take all points with it.
fn is_broken(model: &MapModel, warnings: &[MapWarning]) -> bool {
    let has = |which: fn(&MapWarning) -> bool| warnings.iter().any(which);
    let explained = has(|d| matches!(d, MapWarning::LikelyCause { .. }));
    let empty = has(|d| matches!(d, MapWarning::FewPoints { .. }));
    let failed = model.self_test.as_ref().is_some_and(SelfTest::failed);
    model.points.len() < MIN_POINTS
        || (explained && has(|d| matches!(d, MapWarning::SelfTest { .. })))
        || (empty && failed)
}

/// Minimum number of points for localization: a pose needs ten inliers.
const MIN_POINTS: usize = 10;

/// A self-test as JSON.
#[derive(Serialize)]
pub(super) struct SelfTestInfo {
    images: u32,
    scale: f64,
    assumed_noise_px: f64,
    schemes: Vec<SchemeInfo>,
}

#[derive(Serialize)]
struct SchemeInfo {
    scheme: &'static str,
    localized: u32,
    trusted: u32,
    recall: BTreeMap<String, f64>,
    recall_of_scale: BTreeMap<String, f64>,
    median_rotation_deg: Option<f64>,
    median_translation: Option<f64>,
    noise_px: f64,
    coverage: BeforeAfter,
    calibration: CalibrationInfo,
}

#[derive(Serialize)]
struct BeforeAfter {
    before: CoverageInfo,
    after: CoverageInfo,
}

#[derive(Serialize)]
struct CoverageInfo {
    center: BTreeMap<String, f64>,
    pose: BTreeMap<String, f64>,
}

#[derive(Serialize)]
struct CalibrationInfo {
    factor: f64,
    rotation_floor_deg: f64,
    translation_floor: f64,
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
    pub(super) fn describe(&self) -> String {
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
            "  self-test   {} images, each left out of the map; typical distance to the scene {} map units\n{lines}\
             \x20   Within 1 %: position error below 1 % of that distance, and rotation error below 1°. Median error: map units, \
             degrees.\n    In 90 % region: share of the true poses, before → after the calibration. The calibration multiplies \
             each\n    ± of a position by \"± times\", and none is below \"least ±\" (map units).\n",
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
            recall_of_scale: RELATIVE
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
            format!("{:.0} %", percent_of(&self.recall_of_scale, key(RELATIVE[1]))),
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
