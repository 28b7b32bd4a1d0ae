//! `veiloc localize`: sealed queries to poses, each trusted, doubtful or not found.

mod rig;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use veiloc_geometry::Point3;
use veiloc_localize::{GravityUse, Localization, LocalizeError, LocalizeOptions, localize};
use veiloc_map::MapFile;
use veiloc_query::{PositionHint, SealedQuery};
use veiloc_results::PoseDocument;
use veiloc_robust::{Confidence, PositionPrior, State};

use crate::exit::{Exit, Failure, Outcome};
use crate::files;
use crate::items::{self, Fault, FaultKind, Item, SEALED, SkipArgs, Tally};
use crate::ui::Ui;
use veiloc_arguments::localization_args::{MatchArgs, PoseArgs};

/// Find where sealed queries were taken.
///
/// Prints a line a query: `trusted`, `doubtful` or `not-found`, position of the camera in the map and its standard
/// deviation, how many matches agree, and what speaks against a doubtful pose. With `--json` one document with every pose
/// as quaternion and translation (world to camera), covariance and times.
///
/// Every query is answered for itself: a file that is no sealed query does not stop the others. Ends with
/// 1 when there was such a file or a query for another map, or when no query was localized; else with 4 when a pose is
/// doubtful, else with 0.
///
/// With `--rig` the queries of a session give one pose of the device that took them.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The map.
    #[arg(long, value_name = "FILE")]
    map: PathBuf,
    /// Sealed queries, as `veiloc seal` writes them; folders, of which all `.vquery` files in them and in their
    /// sub-folders are taken; `-` for one from stdin.
    #[arg(required_unless_present = "rig", value_name = "SEALED|FOLDER")]
    queries: Vec<PathBuf>,
    /// A session instead: a JSON file that names up to 32 sealed queries and where on the device each image was taken,
    /// with the deviations of that (docs/json.md). One pose of the device for all.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["queries", "skip_bad"])]
    rig: Option<PathBuf>,
    #[command(flatten)]
    pose: PoseArgs,
    #[command(flatten)]
    matching: MatchArgs,
    /// Where the cameras roughly are, in map units, for example from GPS: a middle and a standard deviation along each
    /// axis. Default: nothing is known.
    #[arg(long, value_name = "X,Y,Z,SD", allow_hyphen_values = true)]
    near: Option<PositionHint>,
    /// Tell trusted poses only: a doubtful one is withheld, though not what speaks against it, and counts as none.
    #[arg(long)]
    trusted_only: bool,
    #[command(flatten)]
    skip: SkipArgs,
    /// Print one JSON document to stdout, with what became of every query.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Document {
    version: u32,
    map: String,
    localized: usize,
    not_localized: usize,
    failed: usize,
    queries: Vec<Query>,
}

/// What became of a query.
#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Status {
    /// It has a pose; whether to trust it is said beside it.
    Localized,
    /// It was read, and no pose was found.
    NotLocalized,
    /// The file could not be used.
    Failed,
}

/// What stands for gravity that took no part, because the map does not know which way is down.
const UNUSED_GRAVITY: &str = "unused";

/// Why a query has no pose, for programs.
#[derive(Clone, Copy, Serialize)]
#[serde(rename_all = "snake_case")]
enum NoPoseKind {
    /// Too few matches agree.
    NoPose,
    /// It was sealed for another map, or for an older state of this one.
    WrongProfile,
    /// The map holds nothing to localize in.
    EmptyMap,
    /// There is a doubtful pose, and trusted ones only are wanted.
    Withheld,
}

/// Why a query has no pose.
#[derive(Serialize)]
#[serde(untagged)]
enum ErrorDocument {
    NotLocalized { kind: NoPoseKind, message: String },
    Failed(Fault),
}

impl ErrorDocument {
    fn message(&self) -> &str {
        match self {
            Self::NotLocalized { message, .. } => message,
            Self::Failed(fault) => &fault.message,
        }
    }
}

#[derive(Serialize)]
struct Query {
    file: String,
    status: Status,
    /// What the answer is worth.
    state: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    cam_from_world: Option<PoseDocument>,
    /// Projection centre in the map, map units.
    #[serde(skip_serializing_if = "Option::is_none")]
    center: Option<[f64; 3]>,
    /// Standard deviation of the centre in its least certain direction, map units: the ± of the text.
    #[serde(skip_serializing_if = "Option::is_none")]
    position_sd: Option<f64>,
    /// Rows and columns: a rotation vector `w` about the camera's axes (radians), then a vector `v` along them (map
    /// units), of `R' = exp(w) R`, `t' = exp(w) t + v`.
    #[serde(skip_serializing_if = "Option::is_none")]
    covariance: Option<[[f64; 6]; 6]>,
    /// Standard deviation that the agreeing rows show, pixels of the query's camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    noise_px: Option<f64>,
    /// Estimated focal length over the one the query names.
    #[serde(skip_serializing_if = "Option::is_none")]
    focal_scale: Option<f64>,
    /// What became of the direction of gravity that the query tells; absent when it tells none.
    #[serde(skip_serializing_if = "Option::is_none")]
    gravity: Option<&'static str>,
    /// Whether nothing speaks against the pose, and what does.
    trusted: bool,
    doubts: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    confidence: Option<ConfidenceDocument>,
    inliers: usize,
    matches: usize,
    hypotheses: usize,
    ms: BTreeMap<&'static str, f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<ErrorDocument>,
}

/// What speaks for and against a pose; see `veiloc_robust::Confidence`.
#[derive(Serialize)]
struct ConfidenceDocument {
    /// Natural logarithm of the evidence against chance.
    #[serde(skip_serializing_if = "Option::is_none")]
    log_evidence: Option<f64>,
    /// Log likelihood by which the pose beats the best other one; absent when no other was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    margin: Option<f64>,
    /// Standard deviation of the camera centre in its least certain direction, map units.
    #[serde(skip_serializing_if = "Option::is_none")]
    center_sd: Option<f64>,
    /// Standard deviation of the orientation about its least certain axis, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    rotation_sd_deg: Option<f64>,
}

impl ConfidenceDocument {
    fn of(confidence: &Confidence) -> Self {
        let finite = |x: f64| x.is_finite().then_some(x);
        Self {
            log_evidence: finite(confidence.log_evidence),
            margin: finite(confidence.margin),
            center_sd: finite(confidence.center_sd),
            rotation_sd_deg: finite(confidence.rotation_sd_deg),
        }
    }
}

pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    if args.queries.iter().filter(|path| files::is_standard(path)).count() > 1 {
        return Err(Failure::with_help("-: stdin is given twice", "it holds one sealed query; give it once"));
    }
    let mut options = args.matching.options(&args.pose);
    options.position = args.near.map(|near| {
        let [x, y, z] = near.center();
        PositionPrior { center: Point3::new(x, y, z), sd: near.sd() }
    });
    if let Some(rig) = &args.rig {
        return rig::run(&args.map, rig, &options, args.trusted_only, args.json, ui);
    }
    let map = MapFile::open(&args.map)?;
    let items = items::gather(&args.queries, &SEALED);
    let mut tally = Tally::begin("localized", &items, ui);
    let stage = (items.len() > 1).then(|| ui.stage("Localizing", items.len() as u64));
    let mut queries = Vec::new();
    for item in &items {
        let query = answer(item, &map, &options, args.trusted_only);
        if let Some(ErrorDocument::Failed(fault)) = &query.error {
            tally.failed(&query.file, fault);
        }
        queries.push(query);
        if let Some(stage) = &stage {
            stage.advance(1);
        }
    }
    if let Some(stage) = &stage {
        stage.finish();
    }
    let count = |status| queries.iter().filter(|q| q.status == status).count();
    let document = Document {
        version: 2,
        map: args.map.display().to_string(),
        localized: count(Status::Localized),
        not_localized: count(Status::NotLocalized),
        failed: count(Status::Failed),
        queries,
    };
    if args.json {
        ui.json(&document)?;
    } else {
        ui.print(table(&document));
    }
    let unused = document.queries.iter().filter(|q| q.gravity == Some(UNUSED_GRAVITY)).count();
    if unused > 0 {
        ui.say(format!(
            "{unused} of {} tell which way is down, and the map does not know it: gravity was not used; build the map with \
             --down",
            document.queries.len()
        ));
    }
    let with = |test: fn(&Query) -> bool| document.queries.iter().filter(|q| test(q)).count();
    let doubtful = with(Query::is_doubtful);
    let remark = |n: usize, what: &str| if n == 0 { String::new() } else { format!(", {n} {what}") };
    let remark = remark(doubtful, "doubtful") + &remark(document.not_localized, "not localized");
    let ended = tally.end(document.localized, &remark, args.skip, ui)?;
    Ok(match ended {
        Exit::Success if with(Query::is_refused) > 0 && !args.skip.counts_none() => Exit::Refused,
        Exit::Success if doubtful > 0 => Exit::Doubtful,
        other => other,
    })
}

impl Query {
    /// Whether it has a pose that something speaks against.
    fn is_doubtful(&self) -> bool {
        self.status == Status::Localized && !self.trusted
    }

    /// Whether it was read, and cannot be used here: it is for another map.
    fn is_refused(&self) -> bool {
        matches!(self.error, Some(ErrorDocument::NotLocalized { kind: NoPoseKind::WrongProfile, .. }))
    }
}

/// What there is to say of one file.
fn answer(item: &Item, map: &MapFile, options: &LocalizeOptions, trusted_only: bool) -> Query {
    let file = item.path.display().to_string();
    let found = match &item.fault {
        Some(fault) => Err(ErrorDocument::Failed(fault.clone())),
        None => decode(&item.path).map_err(ErrorDocument::Failed).and_then(|query| {
            localize(&query, map, options).map_err(|error| match error {
                LocalizeError::WrongProfile { .. } | LocalizeError::Frame { .. } => {
                    not_localized(NoPoseKind::WrongProfile, &error)
                }
                LocalizeError::EmptyMap => not_localized(NoPoseKind::EmptyMap, &error),
                LocalizeError::NoPose { .. } | LocalizeError::Stopped => {
                    not_localized(NoPoseKind::NoPose, &error)
                }
            })
        }),
    };
    match found {
        Ok(found) if trusted_only && found.state != State::Trusted => withheld(found_query(file, &found)),
        Ok(found) => found_query(file, &found),
        Err(error) => lost_query(file, error),
    }
}

fn not_localized(kind: NoPoseKind, error: &LocalizeError) -> ErrorDocument {
    ErrorDocument::NotLocalized { kind, message: error.to_string() }
}

fn decode(path: &Path) -> Result<SealedQuery, Fault> {
    let bytes = if files::is_standard(path) { files::stdin() } else { std::fs::read(path) };
    SealedQuery::decode(&bytes.map_err(|e| Fault::of_io(&e))?).map_err(|e| {
        let remedy = "seal the image again with `veiloc seal`, and send the file unchanged";
        Fault::new(FaultKind::Damaged, format_args!("{e}; {remedy}"))
    })
}

fn found_query(file: String, found: &Localization) -> Query {
    let pose = &found.cam_from_world;
    let c = pose.center().coords;
    Query {
        file,
        status: Status::Localized,
        state: name_of(found.state),
        cam_from_world: Some(PoseDocument::of(pose)),
        center: Some([c.x, c.y, c.z]),
        position_sd: Some(found.confidence.center_sd),
        covariance: Some(found.covariance),
        noise_px: Some(found.noise_px),
        focal_scale: Some(found.focal_scale),
        gravity: match found.gravity {
            GravityUse::NotTold => None,
            GravityUse::Used => Some("used"),
            GravityUse::MapDoesNotKnow => Some(UNUSED_GRAVITY),
        },
        trusted: found.confidence.is_trusted(),
        doubts: found.confidence.doubts().iter().map(ToString::to_string).collect(),
        confidence: Some(ConfidenceDocument::of(&found.confidence)),
        inliers: found.inliers,
        matches: found.matches,
        hypotheses: found.hypotheses,
        ms: [
            ("retrieve", found.times.retrieve_ms),
            ("match", found.times.match_ms),
            ("pose", found.times.pose_ms),
        ]
        .into(),
        error: None,
    }
}

/// The same without its pose, and everything that is said of the pose but what speaks against it.
fn withheld(query: Query) -> Query {
    let message = format!(
        "its pose is withheld: {}; send another frame of the same session, or move on by a step or more first",
        query.doubts.join("; ")
    );
    Query {
        status: Status::NotLocalized,
        cam_from_world: None,
        center: None,
        position_sd: None,
        covariance: None,
        error: Some(ErrorDocument::NotLocalized { kind: NoPoseKind::Withheld, message }),
        ..query
    }
}

const fn name_of(state: State) -> &'static str {
    match state {
        State::Trusted => "trusted",
        State::Doubtful => "doubtful",
        State::NotFound => "not-found",
    }
}

fn lost_query(file: String, error: ErrorDocument) -> Query {
    let status = match error {
        ErrorDocument::NotLocalized { .. } => Status::NotLocalized,
        ErrorDocument::Failed(_) => Status::Failed,
    };
    Query {
        file,
        status,
        state: name_of(State::NotFound),
        cam_from_world: None,
        center: None,
        position_sd: None,
        covariance: None,
        noise_px: None,
        focal_scale: None,
        gravity: None,
        trusted: false,
        doubts: Vec::new(),
        confidence: None,
        inliers: 0,
        matches: 0,
        hypotheses: 0,
        ms: BTreeMap::new(),
        error: Some(error),
    }
}

/// A line for each query that was answered; files that could not be used are told on stderr.
fn table(document: &Document) -> String {
    use std::fmt::Write as _;
    let answered = || document.queries.iter().filter(|q| q.status != Status::Failed);
    let width = answered().map(|q| q.file.chars().count()).max().unwrap_or(0);
    let mut text = String::new();
    for q in answered() {
        let state = q.state;
        let _ = match (&q.center, &q.error) {
            (Some([x, y, z]), _) => {
                let sd = q.position_sd.unwrap_or(f64::INFINITY);
                let total: f64 = q.ms.values().sum();
                writeln!(
                    text,
                    "{:<width$}  {state:<9}  at ({x:.3}, {y:.3}, {z:.3}) ± {sd:.4}  {} of {} matches agree  {total:.0} ms{}",
                    q.file,
                    q.inliers,
                    q.matches,
                    if q.trusted { String::new() } else { format!("  {}", q.doubts.join("; ")) },
                )
            }
            (None, error) => {
                let why = error.as_ref().map_or("not localized", ErrorDocument::message);
                writeln!(text, "{:<width$}  {state:<9}  {why}", q.file)
            }
        };
    }
    text
}
