//! The transform of a map, as text and as JSON.

use serde::Serialize;
use veiloc_map::AlignmentAccuracy;
use veiloc_mapping::align::{Alignment, KnownPositions};
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
    /// How well the new coordinate frame is known; null if that was not measured.
    accuracy: Option<AccuracyInfo>,
    /// Positions that repeat others, and count as one.
    repeated: usize,
    /// Latitude and longitude (degrees) and altitude (metres; null if it is not known) of the origin of a coordinate frame from
    /// GPS; null otherwise. Cameras mostly store the altitude above the sea; a GeoPose needs that above the ellipsoid.
    origin: Option<(f64, f64, Option<f64>)>,
    /// The known positions.
    positions: Vec<PositionInfo>,
    /// Images of the one map that were localized in the other, and agree; null for other targets.
    localized: Option<usize>,
}

/// How well a coordinate frame is known: standard deviations.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct AccuracyInfo {
    /// Of the scale, as a share.
    scale: f64,
    /// Of the up direction, degrees.
    tilt_deg: f64,
    /// Of the rotation about up, degrees.
    heading_deg: f64,
    /// Of the position of `center`, new units.
    position: f64,
    /// Where the position is known best, new units.
    center: [f64; 3],
}

impl From<AlignmentAccuracy> for AccuracyInfo {
    fn from(of: AlignmentAccuracy) -> Self {
        let AlignmentAccuracy { scale, tilt_deg, heading_deg, position, center } = of;
        Self { scale, tilt_deg, heading_deg, position, center }
    }
}

impl AccuracyInfo {
    /// For people.
    pub(super) fn describe(&self, unit: &str) -> String {
        format!(
            "scale ± {} %, up ± {:.1}°, north ± {:.1}°, position ± {} {unit}",
            significant(100.0 * self.scale),
            self.tilt_deg,
            self.heading_deg,
            significant(self.position)
        )
    }
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
            accuracy: None,
            repeated: 0,
            origin: None,
            positions: Vec::new(),
            localized: None,
        }
    }

    /// Of known positions.
    pub(super) fn of_positions(alignment: &Alignment, known: &KnownPositions) -> Self {
        let height = |altitude| alignment.has_heights.then_some(altitude);
        let each = known.positions.iter().zip(&alignment.residuals).zip(&alignment.used);
        let positions = each.map(|((position, distance), used)| PositionInfo {
            name: position.name.clone(),
            distance: *distance,
            used: *used,
        });
        Self {
            rms: Some(alignment.rms),
            accuracy: Some(alignment.accuracy.into()),
            repeated: alignment.repeated,
            origin: known.origin.map(|place| (place.latitude, place.longitude, height(place.altitude))),
            positions: positions.collect(),
            ..Self::of(&alignment.new_from_map)
        }
    }

    /// Of a common coordinate frame of two maps.
    pub(super) fn of_coordinate_frame(frame: &OtherCoordinateFrame) -> Self {
        Self { localized: Some(frame.localized), ..Self::of(&frame.map_from_given) }
    }

    /// With how well the new coordinate frame is known.
    pub(super) fn with_accuracy(self, accuracy: Option<AlignmentAccuracy>) -> Self {
        Self { accuracy: accuracy.map(AccuracyInfo::from), ..self }
    }

    /// What was fitted, and the distance of each position.
    pub(super) fn print(&self, unit: &str, ui: &Ui) {
        self.print_fit(unit, ui);
        for PositionInfo { name, distance, used } in self.positions.iter().take(SHOWN) {
            let note = if *used { "" } else { "  not used" };
            ui.info(format_args!("  {:>10}  {name}{note}", significant(*distance)));
        }
        if self.positions.len() > SHOWN {
            ui.info(format_args!("  … {} more; --json has all", self.positions.len() - SHOWN));
        }
    }

    /// What was fitted.
    pub(super) fn print_fit(&self, unit: &str, ui: &Ui) {
        let angle = Similarity3 {
            rotation: veiloc_geometry::nalgebra::Rotation3::from_matrix_unchecked(
                veiloc_geometry::nalgebra::Matrix3::from_fn(|i, j| self.rotation[i][j]),
            ),
            ..Similarity3::identity()
        }
        .angle_deg();
        ui.info(format_args!("Aligned: scale {:.6}, rotation {angle:.2}°", self.scale));
        if let Some(accuracy) = &self.accuracy {
            ui.info(format_args!("  {}", accuracy.describe(unit)));
        }
        if let Some((latitude, longitude, altitude)) = self.origin {
            let altitude = altitude.map_or_else(
                || "height not known".to_owned(),
                |altitude| {
                    format!(
                        "{altitude:.2} m (cameras mostly store the height above the sea; serve --geo-reference needs that above \
                         the ellipsoid)"
                    )
                },
            );
            ui.info(format_args!("  origin {latitude:.7}, {longitude:.7}, {altitude}; axes east, north, up"));
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
            if self.repeated > 0 {
                ui.info(format_args!("  {} positions repeat others, and count as one", self.repeated));
            }
        }
    }
}

/// Known positions that are printed.
const SHOWN: usize = 30;
