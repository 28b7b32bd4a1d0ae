//! Images whose poses are in another coordinate frame than the map: flags, the remedy, and output.

use serde::Serialize;
use veiloc_mapping::{CoordinateFrameReport, OnOtherCoordinateFrame, OtherCoordinateFrame};

use crate::commands::coordinate_frame_check::CoordinateFrameCheckArgs;
use crate::output::ui::Ui;

/// Treatment of images whose poses are in another coordinate frame.
#[derive(clap::Args)]
pub(super) struct CoordinateFrameArgs {
    /// If the poses of images are in another coordinate frame than the rest of the map (moved, turned, or of another scale),
    /// transform them to the coordinate frame of the map. Default: refuse, and name the images and the distance.
    #[arg(long, conflicts_with = "no_coordinate_frame_check")]
    align: bool,
    #[command(flatten)]
    check: CoordinateFrameCheckArgs,
}

impl CoordinateFrameArgs {
    pub(super) const fn on_other_coordinate_frame(&self) -> OnOtherCoordinateFrame {
        if self.align { OnOtherCoordinateFrame::Align } else { self.check.on_other_coordinate_frame() }
    }
}

/// Prints the result of the comparison.
pub(super) fn print(report: &CoordinateFrameReport, ui: &Ui) {
    let CoordinateFrameReport { tested, localized, .. } = report;
    for frame in &report.aligned {
        ui.info(format!("Aligned to the coordinate frame of the map: {frame}"));
    }
    if *localized > 0 {
        let unknown = match tested - localized {
            0 => String::new(),
            unknown => format!("; the coordinate frame of the other {unknown} could not be checked"),
        };
        ui.info(format!(
            "Coordinate frame of the poses: {localized} of {tested} images localized in the map without them{unknown}"
        ));
    }
}

/// Comparison of the given poses with the coordinate frame of the map.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct CoordinateFrameInfo {
    /// Number of images that were compared or should have been.
    tested: usize,
    /// Number of them that were localized, with a trusted pose, in the map without them; the frame of the others could
    /// not be checked.
    localized: usize,
    /// Median distance between given and localized camera centres over the images that agree, map units.
    median_distance: f64,
    /// Names of images that the map localizes with other poses, without a common transform.
    disagreeing: Vec<String>,
    /// Names of images that agree on a coordinate frame only a little away from the map's: by more than their ±, but too little to
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

impl CoordinateFrameInfo {
    pub(super) fn of(report: &CoordinateFrameReport) -> Self {
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
    fn of(frame: &OtherCoordinateFrame) -> Self {
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
