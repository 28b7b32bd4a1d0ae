//! `veiloc map align`: transforms a map to metres, north, gravity, or the coordinate frame of another map.

use std::path::PathBuf;

use veiloc_map::{GravityDirection, MapFile, MapModel};
use veiloc_mapping::Similarity3;
use veiloc_mapping::align::{self, KnownPosition};

use super::alignment::AlignmentInfo;
use super::edit::MapEdit;
use super::facts::InfoOutput;
use super::self_test::FinishArgs;
use crate::commands::posed::read_posed_input;
use crate::output::exit::{Failure, Outcome};
use crate::output::position::unit_of;
use crate::output::stages::Stages;
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

/// Transform a map to another world frame: to metres, north and gravity, or to the coordinate frame of another map.
///
/// Known positions determine a similarity (scale, rotation, translation); up to half of them may be wrong, and the distance of each
/// one is printed. With GPS, the new coordinate frame is east, north, up in metres about the first image with GPS. The map tests itself again
/// at the end, because the calibration of its answers has lengths.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("target").required(true))]
pub(crate) struct AlignArgs {
    /// The map.
    map: PathBuf,
    /// Align to known positions: lines `NAME X Y Z` (the centre of an image's camera) or `X Y Z X Y Z` (a point in the map, and in
    /// the new coordinate frame), with commas or spaces; three or more that are not on a line.
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

/// A transform to another coordinate frame.
struct Found {
    similarity: Similarity3,
    info: AlignmentInfo,
    /// Whether lengths of the new coordinate frame are metres, as far as known.
    is_metric: bool,
}

fn find(args: &AlignArgs, model: &MapModel, ui: &Ui) -> Result<Found, Failure> {
    if let Some(reference) = &args.to_map {
        let reference = MapFile::open(reference)?.to_model();
        let frame = align::align_to_map(model, &reference, &Stages::new(ui))?;
        return Ok(Found {
            similarity: frame.map_from_given,
            info: AlignmentInfo::of_coordinate_frame(&frame),
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
    let info = AlignmentInfo::of_positions(&alignment, &positions, origin);
    Ok(Found { similarity: alignment.new_from_map, info, is_metric })
}
