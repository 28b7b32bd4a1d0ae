//! `veiloc map align`: transforms a map to metres, north, gravity, or the coordinate frame of another map.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use veiloc_geometry::nalgebra::Vector3;
use veiloc_map::{AlignmentAccuracy, GravityDirection, GravityDirectionError, MapFile, MapModel};
use veiloc_mapping::Similarity3;
use veiloc_mapping::align::{self, AlignmentFault, KnownPosition, KnownPositions, MapUp};

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
/// Known positions determine a similarity (scale, rotation, translation), with the direction of gravity in the map, or as its images
/// show it; up to half of them may be wrong, and the distance of each one is printed. The ± of scale, up, north and position are
/// printed and kept in the map, and GeoPoses include them. A fit that is not to be believed is refused with the reasons. With GPS,
/// the new coordinate frame is east, north, up in metres about the first image with GPS. The map tests itself again at the end,
/// because the calibration of its answers has lengths. Content anchors beside the map move with it.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("target").required(true))]
pub(crate) struct AlignArgs {
    /// The map.
    map: PathBuf,
    /// Align to known positions: lines `NAME X Y Z` (the centre of an image's camera) or `X Y Z X Y Z` (a point in the map, and in
    /// the new coordinate frame), with commas or spaces; two or more that are not above each other. `z` is up, or see --known-down.
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
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, conflicts_with = "to_map")]
    down: Option<GravityDirection>,
    /// Direction of gravity (down) in the axes of the positions of --positions or --posed; `none` if it is not known. Default: -z
    /// for --positions, and for --posed that of its format, if it defines one.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, conflicts_with_all = ["gps", "to_map", "level"])]
    known_down: Option<KnownDown>,
    /// Write the map although its fit is not to be believed.
    #[arg(long)]
    accept_fit: bool,
    #[command(flatten)]
    finish: FinishArgs,
    /// The map file to write. Default: the map itself.
    #[arg(long, short, value_name = "FILE")]
    out: Option<OutFile>,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

/// A direction of gravity, or none.
#[derive(Debug, Clone, Copy)]
struct KnownDown(Option<GravityDirection>);

impl FromStr for KnownDown {
    type Err = GravityDirectionError;

    fn from_str(text: &str) -> Result<Self, GravityDirectionError> {
        if text == "none" { Ok(Self(None)) } else { text.parse().map(|down| Self(Some(down))) }
    }
}

pub(super) fn run(args: &AlignArgs, ui: &Ui) -> Outcome {
    let edit = MapEdit::begin(&args.map, args.out.as_deref(), ui)?;
    let mut model = edit.read()?;
    if args.down.is_some() {
        model.down = args.down;
    }
    let Found { similarity, info: alignment, is_metric, down, accuracy } = find(args, &model, edit.out, ui)?;
    align::transform(&mut model, &similarity)?;
    model.is_metric = is_metric;
    model.down = down.or(model.down);
    model.alignment = accuracy;
    let mut warnings = Vec::new();
    args.finish.finish(&mut model, &mut warnings, edit.out, ui)?;
    edit.write_with(&model, |anchors| Ok(align::carry_anchors(anchors, &similarity)?))?;
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
    /// The direction of gravity in the new coordinate frame, if the target has it.
    down: Option<GravityDirection>,
    /// How well the new coordinate frame is known, if that was measured.
    accuracy: Option<AlignmentAccuracy>,
}

fn find(args: &AlignArgs, model: &MapModel, out: &Path, ui: &Ui) -> Result<Found, Failure> {
    if let Some(reference) = &args.to_map {
        let reference = MapFile::open(reference)?.to_model();
        let frame = align::align_to_map(model, &reference, &Stages::new(ui))?;
        let accuracy = align::accuracy_in_map(model, &frame, reference.alignment);
        let info = AlignmentInfo::of_coordinate_frame(&frame).with_accuracy(Some(accuracy));
        judge(
            args,
            &align::faults_in_map(model, &frame, &reference),
            &info,
            unit_of(reference.is_metric),
            out,
            ui,
        )?;
        return Ok(Found {
            similarity: frame.map_from_given,
            info,
            is_metric: reference.is_metric,
            down: reference.down,
            accuracy: Some(accuracy),
        });
    }
    if args.level {
        return level(model, ui);
    }
    let known = known_positions(args, model, ui)?;
    for remark in &known.remarks {
        ui.warn(format_args!("warning: {remark}"));
    }
    let mut alignment = align::align_to_positions(&known, MapUp::of(model))?;
    if known.is_metric {
        alignment.faults.extend(align::implausible_metres(model, alignment.new_from_map.scale));
    }
    let info = AlignmentInfo::of_positions(&alignment, &known);
    judge(args, &alignment.faults, &info, unit_of(args.gps.is_some() || args.metres), out, ui)?;
    Ok(Found {
        similarity: alignment.new_from_map,
        info,
        is_metric: known.is_metric,
        down: known.down,
        accuracy: Some(alignment.accuracy),
    })
}

/// Refuses a fit that is not to be believed.
fn judge(
    args: &AlignArgs,
    faults: &[AlignmentFault],
    info: &AlignmentInfo,
    unit: &str,
    out: &Path,
    ui: &Ui,
) -> Result<(), Failure> {
    if faults.is_empty() {
        return Ok(());
    }
    let faults: Vec<String> = faults.iter().map(AlignmentFault::to_string).collect();
    if args.accept_fit {
        for fault in &faults {
            ui.warn(format_args!("warning: {fault}"));
        }
        return Ok(());
    }
    info.print_fit(unit, ui);
    Err(Failure::with_help(
        format!("{}: not written: the fit is not to be believed: {}", out.display(), faults.join("; ")),
        "correct the positions, or write the map all the same with --accept-fit",
    ))
}

fn level(model: &MapModel, ui: &Ui) -> Result<Found, Failure> {
    let (up, sd_deg) = if let Some(up) = MapUp::of_gravity(model) {
        (up.direction, up.sd_deg)
    } else {
        let found = align::up_of_images(model)?;
        let on_side = match found.on_side {
            0 => String::new(),
            count => format!("; {count} are stored on their side"),
        };
        ui.info(format_args!(
            "Gravity by the images to ± {:.1}°; their horizontal axes are tilted by {:.1}° in the median{on_side}",
            found.sd_deg * std::f64::consts::SQRT_2,
            found.tilt_deg
        ));
        (found.direction, found.sd_deg)
    };
    let similarity = align::level(&up);
    // Of an earlier alignment all but the tilt stays.
    let accuracy = model.alignment.map(|before| AlignmentAccuracy {
        tilt_deg: sd_deg * std::f64::consts::SQRT_2,
        center: similarity.transform(&Vector3::from(before.center)).into(),
        ..before
    });
    Ok(Found {
        similarity,
        info: AlignmentInfo::of(&similarity).with_accuracy(accuracy),
        is_metric: model.is_metric,
        down: Some(GravityDirection::MINUS_Z),
        accuracy,
    })
}

fn known_positions(args: &AlignArgs, model: &MapModel, ui: &Ui) -> Result<KnownPositions, Failure> {
    if let Some(images) = &args.gps {
        return Ok(align::gps_positions(model, images)?);
    }
    let mut known = if let Some(path) = &args.positions {
        align::read_positions(path, model)?
    } else {
        let posed = args.posed.as_deref().ok_or_else(|| Failure::refused("give a target"))?;
        let beside = if posed.is_dir() { Some(posed) } else { posed.parent() };
        let images = args.images.as_deref().or(beside).unwrap_or(posed);
        let read = read_posed_input(posed, images, ui)?;
        let center = |pose: &veiloc_geometry::CameraFromWorld| pose.center().coords;
        let of = |image: &veiloc_map::MapImage| {
            let known = center(&read.images.get(&image.name)?.cam_from_world);
            let in_map = center(&image.cam_from_world);
            Some(KnownPosition { name: image.name.clone(), in_map, known, has_height: true, sd: 0.0 })
        };
        KnownPositions {
            positions: model.images.iter().filter_map(of).collect(),
            down: read.down,
            has_heights: true,
            is_metric: read.is_metric,
            ..KnownPositions::default()
        }
    };
    known.is_metric |= args.metres;
    if let Some(KnownDown(down)) = args.known_down {
        known.down = down;
    }
    Ok(known)
}
