//! Images whose poses are in another frame than the map: flags, the remedy, and output.

use serde::Serialize;
use veiloc_mapping::{FrameReport, OnOtherFrame, OtherFrame};

use crate::commands::frame_check::FrameCheckArgs;
use crate::output::ui::Ui;

/// Treatment of images whose poses are in another frame.
#[derive(clap::Args)]
pub(super) struct FrameArgs {
    /// If the poses of images are in another frame than the rest of the map (moved, turned, or of another scale),
    /// transform them to the frame of the map. Default: refuse, and name the images and the distance.
    #[arg(long, conflicts_with = "no_frame_check")]
    align: bool,
    #[command(flatten)]
    check: FrameCheckArgs,
}

impl FrameArgs {
    pub(super) const fn on_other_frame(&self) -> OnOtherFrame {
        if self.align { OnOtherFrame::Align } else { self.check.on_other_frame() }
    }
}

/// Prints the result of the comparison.
pub(super) fn print(report: &FrameReport, ui: &Ui) {
    let FrameReport { tested, localized, .. } = report;
    for frame in &report.aligned {
        ui.info(format!("Aligned to the frame of the map: {frame}"));
    }
    if *localized > 0 {
        let unknown = match tested - localized {
            0 => String::new(),
            unknown => format!("; the frame of the other {unknown} could not be checked"),
        };
        ui.info(format!(
            "Frame of the poses: {localized} of {tested} images localized in the map without them{unknown}"
        ));
    }
}

/// Comparison of the given poses with the frame of the map.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct FrameInfo {
    /// Number of images that were compared or should have been.
    tested: usize,
    /// Number of them that were localized, with a trusted pose, in the map without them; the frame of the others could
    /// not be checked.
    localized: usize,
    /// Median distance between given and localized camera centres over the images that agree, map units.
    median_distance: f64,
    /// Names of images that the map localizes with other poses, without a common transform.
    disagreeing: Vec<String>,
    /// Names of images that agree on a frame only a little away from the map's: by more than their ±, but too little to
    /// refuse them.
    near: Vec<String>,
    /// Groups whose poses `--align` transformed.
    aligned: Vec<AlignedInfo>,
}

/// A group of images whose poses were transformed, `x_map = scale R x_given + t`.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct AlignedInfo {
    /// Names of the images.
    images: Vec<String>,
    /// Number of the localized images that agree on the transform.
    localized: usize,
    /// Median distance between the given and the transformed camera centres, map units.
    distance: f64,
    /// Its standard deviation.
    distance_sd: f64,
    /// Angle of the rotation, degrees.
    angle_deg: f64,
    /// Its standard deviation.
    angle_sd_deg: f64,
    /// Scale.
    scale: f64,
    /// Its standard deviation; null if the camera centres do not determine the scale, which is then 1.
    scale_sd: Option<f64>,
    /// `R`, row by row.
    rotation: [[f64; 3]; 3],
    /// `t`, map units.
    translation: [f64; 3],
}

impl FrameInfo {
    pub(super) fn of(report: &FrameReport) -> Self {
        Self {
            tested: report.tested,
            localized: report.localized,
            median_distance: report.median_distance,
            disagreeing: report.disagreeing.clone(),
            near: report.near.clone(),
            aligned: report.aligned.iter().map(AlignedInfo::of).collect(),
        }
    }
}

impl AlignedInfo {
    fn of(frame: &OtherFrame) -> Self {
        let similarity = &frame.map_from_given;
        let matrix = similarity.rotation.matrix();
        Self {
            images: frame.names.clone(),
            localized: frame.localized,
            distance: frame.distance,
            distance_sd: frame.distance_sd,
            angle_deg: similarity.angle_deg(),
            angle_sd_deg: frame.angle_sd_deg,
            scale: similarity.scale,
            scale_sd: frame.scale_sd,
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)])),
            translation: similarity.translation.into(),
        }
    }
}
