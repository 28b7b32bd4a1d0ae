//! `veiloc localize`: estimates the poses of sealed queries; each pose is trusted, doubtful or not found.

pub(crate) mod document;
mod from_images;
mod pose_files;
mod report;
pub(crate) mod rig;

use std::path::{Path, PathBuf};

use veiloc_geometry::Point3;
use veiloc_localization::{LocalizeOptions, localize};
use veiloc_map::MapFile;
use veiloc_pose::PositionPrior;
use veiloc_protocol::{Answer, GravityUse, PoseDocument, PositionHint, SealedQuery};

use self::document::{ErrorDocument, LocalizeDocument, LocalizedQuery, StateCounts, table};
use self::from_images::ImageArgs;
use self::pose_files::{PoseFileArgs, QueryPose};
use crate::args::need::Need;
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::files;
use crate::output::items::{self, BatchSummary, InputError, InputErrorKind, Item, SEALED, SkipArgs};
use crate::output::ui::Ui;

/// Estimate the poses of sealed queries.
///
/// Prints one line per query: `trusted`, `doubtful` or `not-found`, the camera position in the map and its standard
/// deviation, the number of inliers, and the reasons for doubt. With `--json` prints one document with every pose as
/// quaternion and translation (world to camera), covariance and times.
///
/// Queries are independent: a file that is not a sealed query does not stop the others. The exit code is 1 if there was
/// such a file or a query for another map, or if no query was localized; otherwise 4 if a pose is doubtful, and 0
/// otherwise.
///
/// With `--rig` the queries of a session give one pose of the device.
///
/// With `--queries LIST --images DIR` both sides run here: each image of the list is sealed as on a device, and the
/// sealed query is localized. `--out-hloc`, `--out-colmap` and `--out-tum` write the poses for other programs: doubtful
/// ones too, unless `--trusted-only` is given.
#[derive(clap::Args)]
#[command(mut_args(from_images::tie_to_list))]
pub(crate) struct Args {
    /// The map.
    #[arg(long, value_name = "FILE")]
    map: PathBuf,
    /// Sealed queries, as written by `veiloc seal`; folders, with all `.vquery` files in them and their sub-folders;
    /// `-` for one from stdin.
    #[arg(required_unless_present_any = ["rig", "list"], value_name = "SEALED|FOLDER")]
    queries: Vec<PathBuf>,
    /// A session instead: a JSON file that names up to 32 sealed queries with the pose of each camera on the device and
    /// its standard deviations (docs/reference/formats.md). Gives one pose of the device.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["queries", "skip_bad", "report_file"])]
    rig: Option<PathBuf>,
    #[command(flatten)]
    images: ImageArgs,
    /// Approximate camera position in map units, for example from GPS: a mean and a standard deviation along each axis.
    /// Default: no prior position.
    #[arg(long, value_name = "X,Y,Z,SD", allow_hyphen_values = true)]
    near: Option<PositionHint>,
    /// Largest ± of a trusted pose: its position, its orientation, or both. A pose with a larger ± is doubtful. A position
    /// without `cm` or `m` is in map units. Default: any ±; it is part of every answer.
    #[arg(long, value_name = "25cm,2deg")]
    need: Option<Need>,
    /// Output trusted poses only: a doubtful pose is withheld; its reasons for doubt are still reported.
    #[arg(long)]
    trusted_only: bool,
    #[command(flatten)]
    written: PoseFileArgs,
    #[command(flatten)]
    report: report::ReportArgs,
    #[command(flatten)]
    skip: SkipArgs,
    /// Print one JSON document with the result of every query to stdout.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    if args.queries.iter().filter(|path| files::is_standard(path)).count() > 1 {
        return Err(Failure::with_help(
            "-: stdin is given twice",
            "stdin has one sealed query; give it once",
        ));
    }
    let mut options = LocalizeOptions::default();
    options.position = args.near.map(|near| {
        let [x, y, z] = near.center();
        PositionPrior { center: Point3::new(x, y, z), sd: near.sd() }
    });
    if let Some(rig) = &args.rig {
        return rig::run(&args.map, rig, options, args.need, args.trusted_only, args.json, ui);
    }
    let map = MapFile::open(&args.map)?;
    options.need = Need::in_map(args.need, &map)?;
    let sealing = args.images.read(&map, ui)?;
    let items = match &sealing {
        Some(sealing) => sealing.items(),
        None => items::expand_inputs(&args.queries, &SEALED),
    };
    args.written.check(&items, sealing.is_some())?;
    let mut tally = BatchSummary::begin("localized", &items, ui);
    let stage = (items.len() > 1).then(|| ui.stage("Localizing", items.len() as u64));
    let (mut queries, mut cameras, mut drawable) = (Vec::new(), Vec::new(), Vec::new());
    for (index, item) in items.iter().enumerate() {
        let (file, sealed, camera) = match &sealing {
            Some(sealing) => {
                let sealed = sealing.seal(index)?;
                let camera = sealed.as_ref().ok().map(|(_, camera)| *camera);
                (item.name().to_owned(), sealed.map(|(query, _)| query), camera)
            }
            None => (item.path.display().to_string(), read_sealed(item), None),
        };
        drawable.push(sealed.as_ref().ok().filter(|_| args.report.is_requested()).cloned());
        let result = answer(sealed, &map, &options, args.trusted_only);
        if let Err(ErrorDocument::Failed(fault)) = &result {
            tally.failed(&file, fault);
        }
        queries.push(LocalizedQuery { file, result });
        cameras.push(camera);
        if let Some(stage) = &stage {
            stage.advance(1);
        }
    }
    if let Some(stage) = &stage {
        stage.finish();
    }
    let name = args.map.display().to_string();
    if args.json {
        ui.json(&LocalizeDocument::new(name.clone(), &queries))?;
    } else {
        ui.print(table(&queries));
    }
    let poses = items.iter().zip(&queries).zip(&cameras).map(|((item, query), camera)| QueryPose {
        name: pose_files::name_of(item, sealing.is_some()),
        pose: query.answer().and_then(|answer| Some(PoseDocument::of(&answer.pose?.cam_from_world()?))),
        camera: *camera,
    });
    args.written.write(&poses.collect::<Vec<_>>(), ui)?;
    args.report.write(&name, &queries, &drawable, &map, &options, ui)?;
    let is_unused = |answer: &&Answer| answer.gravity == GravityUse::UnknownInMap;
    let unused = queries.iter().filter_map(LocalizedQuery::answer).filter(is_unused).count();
    if unused > 0 {
        ui.info(format!(
            "{unused} of {} have a direction of gravity, and the map has none: gravity was not used; \
             build the map with --down",
            queries.len()
        ));
    }
    let counts = StateCounts::of(&queries);
    let doubtful = counts.doubtful - counts.withheld;
    let remark = |n: usize, what: &str| if n == 0 { String::new() } else { format!(", {n} {what}") };
    let remark = remark(doubtful, "doubtful")
        + &remark(counts.withheld, "withheld")
        + &remark(counts.not_found, "not localized");
    let ended = tally.end(counts.with_pose(), &remark, args.skip, ui)?;
    let is_refused = queries.iter().any(LocalizedQuery::is_refused);
    Ok(match ended {
        Exit::Success if is_refused && !args.skip.ignores_failures() => Exit::Refused,
        Exit::Success if doubtful > 0 => Exit::Doubtful,
        other => other,
    })
}

/// Returns the answer to a sealed query, or the reason why there is none.
fn answer(
    sealed: Result<SealedQuery, InputError>,
    map: &MapFile,
    options: &LocalizeOptions,
    trusted_only: bool,
) -> Result<Answer, ErrorDocument> {
    let query = sealed.map_err(ErrorDocument::Failed)?;
    let answer = localize(&query, map, options).map_err(|error| ErrorDocument::of(&error))?.answer(map);
    Ok(if trusted_only { answer.trusted_only() } else { answer })
}

/// Reads a sealed query from a file.
fn read_sealed(item: &Item) -> Result<SealedQuery, InputError> {
    match &item.fault {
        Some(fault) => Err(fault.clone()),
        None => decode(&item.path),
    }
}

fn decode(path: &Path) -> Result<SealedQuery, InputError> {
    let bytes = if files::is_standard(path) { files::stdin() } else { std::fs::read(path) };
    SealedQuery::decode(&bytes.map_err(|e| InputError::of_io(&e))?).map_err(|e| {
        let remedy = "seal the image again with `veiloc seal`, and send the file unchanged";
        InputError::new(InputErrorKind::Damaged, format_args!("{e}; {remedy}"))
    })
}
