//! The transform of a map, as text and as JSON.

use serde::Serialize;
use veiloc_mapping::align::{Alignment, KnownPosition};
use veiloc_mapping::{OtherCoordinateFrame, Similarity3};
use veiloc_report::significant;

use crate::output::ui::Ui;

/// The transform of a map, `x_new = scale R x_old + t`.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct AlignmentInfo {
    /// Scale.
    scale: f64,
    /// `R`, row by row.
    rotation: [[f64; 3]; 3],
    /// `t`, new units.
    translation: [f64; 3],
    /// Root mean square of the distances of the positions that were used, new units; null if there were no positions.
    rms: Option<f64>,
    /// Latitude and longitude (degrees) and altitude (metres) of the origin of a coordinate frame from GPS; null otherwise.
    origin: Option<[f64; 3]>,
    /// The known positions.
    positions: Vec<PositionInfo>,
    /// Images of the one map that were localized in the other, and agree; null for other targets.
    localized: Option<usize>,
}

/// A known position.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct PositionInfo {
    /// Name of the image, or the line of the file.
    name: String,
    /// Distance between the transformed and the known position, new units.
    distance: f64,
    /// Whether it was used.
    used: bool,
}

impl AlignmentInfo {
    pub(super) fn of(similarity: &Similarity3) -> Self {
        let matrix = similarity.rotation.matrix();
        Self {
            scale: similarity.scale,
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)])),
            translation: similarity.translation.into(),
            rms: None,
            origin: None,
            positions: Vec::new(),
            localized: None,
        }
    }

    /// Of known positions; `origin`: of a coordinate frame from GPS.
    pub(super) fn of_positions(
        alignment: &Alignment,
        positions: &[KnownPosition],
        origin: Option<[f64; 3]>,
    ) -> Self {
        let each = positions.iter().zip(&alignment.residuals).zip(&alignment.used);
        let positions = each.map(|((position, distance), used)| PositionInfo {
            name: position.name.clone(),
            distance: *distance,
            used: *used,
        });
        Self {
            rms: Some(alignment.rms),
            origin,
            positions: positions.collect(),
            ..Self::of(&alignment.new_from_map)
        }
    }

    /// Of a common coordinate frame of two maps.
    pub(super) fn of_coordinate_frame(frame: &OtherCoordinateFrame) -> Self {
        Self { localized: Some(frame.localized), ..Self::of(&frame.map_from_given) }
    }

    pub(super) fn print(&self, unit: &str, ui: &Ui) {
        let angle = Similarity3 {
            rotation: veiloc_geometry::nalgebra::Rotation3::from_matrix_unchecked(
                veiloc_geometry::nalgebra::Matrix3::from_fn(|i, j| self.rotation[i][j]),
            ),
            ..Similarity3::identity()
        }
        .angle_deg();
        ui.info(format_args!("Aligned: scale {:.6}, rotation {angle:.2}°", self.scale));
        if let Some([latitude, longitude, altitude]) = self.origin {
            ui.info(format_args!(
                "  origin {latitude:.7}, {longitude:.7}, {altitude:.2} m; axes east, north, up"
            ));
        }
        if let Some(localized) = self.localized {
            ui.info(format_args!("  {localized} images localized in the other map agree"));
        }
        if let Some(rms) = self.rms {
            let used = self.positions.iter().filter(|position| position.used).count();
            ui.info(format_args!(
                "  {used} of {} positions used, root mean square distance {} {unit}",
                self.positions.len(),
                significant(rms)
            ));
            for PositionInfo { name, distance, used } in self.positions.iter().take(SHOWN) {
                let note = if *used { "" } else { "  not used" };
                ui.info(format_args!("  {:>10}  {name}{note}", significant(*distance)));
            }
            if self.positions.len() > SHOWN {
                ui.info(format_args!("  … {} more; --json has all", self.positions.len() - SHOWN));
            }
        }
    }
}

/// Known positions that are printed.
const SHOWN: usize = 30;
