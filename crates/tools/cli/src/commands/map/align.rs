//! `veiloc map align`: transforms a map to metres, north, gravity, or the frame of another map.

use std::path::PathBuf;

use serde::Serialize;
use veiloc_map::{GravityDirection, MapFile, MapModel};
use veiloc_mapping::align::{self, Alignment, KnownPosition};
use veiloc_mapping::{OtherFrame, Similarity3};
use veiloc_report::significant;

use super::MapEdit;
use super::info::InfoOutput;
use super::self_test::FinishArgs;
use crate::commands::posed::read_posed_input;
use crate::output::exit::{Failure, Outcome};
use crate::output::position::unit_of;
use crate::output::stages::Stages;
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

/// Transform a map to another world frame: to metres, north and gravity, or to the frame of another map.
///
/// Known positions determine a similarity (scale, rotation, translation); up to half of them may be wrong, and the distance of each
/// one is printed. With GPS, the new frame is east, north, up in metres about the first image with GPS. The map tests itself again
/// at the end, because the calibration of its answers has lengths.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("target").required(true))]
pub(crate) struct AlignArgs {
    /// The map.
    map: PathBuf,
    /// Align to known positions: lines `NAME X Y Z` (the centre of an image's camera) or `X Y Z X Y Z` (a point in the map, and in
    /// the new frame), with commas or spaces; three or more that are not on a line.
    #[arg(long, value_name = "FILE", group = "target")]
    positions: Option<PathBuf>,
    /// Align to the camera positions of posed images, for example of an AR capture of the same images; any format that `map build
    /// --posed` reads.
    #[arg(long, value_name = "PATH", group = "target")]
    posed: Option<PathBuf>,
    /// Folder of the images of --posed, for formats that need it. Default: the folder of --posed.
    #[arg(long, value_name = "DIR", requires = "posed")]
    images: Option<PathBuf>,
    /// Align to GPS in the EXIF of the images in this folder (WGS 84): east, north, up, metres.
    #[arg(long, value_name = "DIR", group = "target")]
    gps: Option<PathBuf>,
    /// Align to another map of the same place, by localizing images of this map in it.
    #[arg(long, value_name = "MAP", group = "target")]
    to_map: Option<PathBuf>,
    /// Rotate the map so that gravity is −z: by the direction that the map has or --down gives, or else by its images, which are
    /// mostly taken with a level horizontal axis.
    #[arg(long, group = "target")]
    level: bool,
    /// The positions of --positions, or the poses of --posed, are in metres. Default: with --posed, if its format defines it;
    /// GPS is in metres, and --to-map has the unit of the other map.
    #[arg(long, conflicts_with_all = ["gps", "to_map", "level"])]
    metres: bool,
    /// Direction of gravity (down) in the axes of the map, as for `map build`. Default: that of the map, or else of its
    /// images.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, requires = "level")]
    down: Option<GravityDirection>,
    #[command(flatten)]
    finish: FinishArgs,
    /// The map file to write. Default: the map itself.
    #[arg(long, short, value_name = "FILE")]
    out: Option<OutFile>,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

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
    /// Latitude and longitude (degrees) and altitude (metres) of the origin of a frame from GPS; null otherwise.
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
    fn of(similarity: &Similarity3) -> Self {
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

    fn of_positions(alignment: &Alignment, positions: &[KnownPosition]) -> Self {
        let each = positions.iter().zip(&alignment.residuals).zip(&alignment.used);
        let positions = each.map(|((position, distance), used)| PositionInfo {
            name: position.name.clone(),
            distance: *distance,
            used: *used,
        });
        Self { rms: Some(alignment.rms), positions: positions.collect(), ..Self::of(&alignment.new_from_map) }
    }

    /// Of a common frame of two maps.
    pub(super) fn of_frame(frame: &OtherFrame) -> Self {
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

pub(super) fn run(args: &AlignArgs, ui: &Ui) -> Outcome {
    let edit = MapEdit::begin(&args.map, args.out.as_deref(), ui)?;
    let mut model = edit.read()?;
    let Found { similarity, info: alignment, is_metric } = find(args, &model, ui)?;
    align::transform(&mut model, &similarity)?;
    model.is_metric = is_metric;
    let mut warnings = Vec::new();
    args.finish.finish(&mut model, &mut warnings, edit.out, ui)?;
    edit.write(&model)?;
    alignment.print(unit_of(is_metric), ui);
    InfoOutput { json: args.json, warnings, alignment: Some(alignment), ..InfoOutput::default() }
        .print(edit.out, ui)
}

/// A transform to another frame.
struct Found {
    similarity: Similarity3,
    info: AlignmentInfo,
    /// Whether lengths of the new frame are metres, as far as known.
    is_metric: bool,
}

fn find(args: &AlignArgs, model: &MapModel, ui: &Ui) -> Result<Found, Failure> {
    if let Some(reference) = &args.to_map {
        let reference = MapFile::open(reference)?.to_model();
        let frame = align::align_to_map(model, &reference, &Stages::new(ui))?;
        return Ok(Found {
            similarity: frame.map_from_given,
            info: AlignmentInfo::of_frame(&frame),
            is_metric: reference.is_metric,
        });
    }
    if args.level {
        let level = align::level(model, args.down)?;
        if let Some(tilt) = level.tilt_deg {
            ui.info(format_args!(
                "Gravity by the images, whose horizontal axes are tilted by {tilt:.1}° in the median"
            ));
        }
        return Ok(Found {
            similarity: level.new_from_map,
            info: AlignmentInfo::of(&level.new_from_map),
            is_metric: model.is_metric,
        });
    }
    let (mut origin, mut is_metric) = (None, args.metres);
    let positions = if let Some(path) = &args.positions {
        let (positions, unknown) = align::read_positions(path, model)?;
        if let Some(first) = unknown.first() {
            ui.warn(format_args!(
                "warning: {}: {} names are not in the map, the first is {first}",
                path.display(),
                unknown.len()
            ));
        }
        positions
    } else if let Some(images) = &args.gps {
        let (positions, place) = align::gps_positions(model, images)?;
        origin = Some([place.latitude, place.longitude, place.altitude]);
        is_metric = true;
        positions
    } else {
        let posed = args.posed.as_deref().ok_or_else(|| Failure::refused("give a target"))?;
        let beside = if posed.is_dir() { Some(posed) } else { posed.parent() };
        let images = args.images.as_deref().or(beside).unwrap_or(posed);
        let read = read_posed_input(posed, images, ui)?;
        is_metric |= read.is_metric;
        let known = read.images;
        let center = |pose: &veiloc_geometry::CameraFromWorld| pose.center().coords;
        let of = |image: &veiloc_map::MapImage| {
            let known = center(&known.get(&image.name)?.cam_from_world);
            Some(KnownPosition { name: image.name.clone(), in_map: center(&image.cam_from_world), known })
        };
        model.images.iter().filter_map(of).collect()
    };
    let alignment = align::align_to_positions(&positions)?;
    let info = AlignmentInfo { origin, ..AlignmentInfo::of_positions(&alignment, &positions) };
    Ok(Found { similarity: alignment.new_from_map, info, is_metric })
}
