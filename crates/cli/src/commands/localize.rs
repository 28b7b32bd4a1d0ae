//! `veiloc localize`: sealed queries to poses.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;
use veiloc_eval::results::PoseDocument;
use veiloc_localize::{Localization, localize};
use veiloc_map::MapFile;
use veiloc_query::SealedQuery;
use veiloc_robust::Confidence;

use crate::commands::localization_args::{MatchArgs, PoseArgs};
use crate::exit::{Exit, Failure, Outcome};
use crate::files;
use crate::ui::Ui;

/// Find where sealed queries were taken.
///
/// Prints a line a query: position of the camera in the map, the direction it looks, how far to trust it. With
/// `--json` one document with every pose as quaternion and translation (world to camera), covariance and times.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The map.
    #[arg(long, value_name = "FILE")]
    map: PathBuf,
    /// Sealed queries, as `veiloc seal` writes them.
    #[arg(required = true, value_name = "SEALED")]
    queries: Vec<PathBuf>,
    #[command(flatten)]
    pose: PoseArgs,
    #[command(flatten)]
    matching: MatchArgs,
    /// Print one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Document {
    version: u32,
    map: String,
    localized: usize,
    queries: Vec<Query>,
}

#[derive(Serialize)]
struct Query {
    file: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    cam_from_world: Option<PoseDocument>,
    /// Projection centre in the map, map units.
    #[serde(skip_serializing_if = "Option::is_none")]
    center: Option<[f64; 3]>,
    /// Rows and columns: rotation about the camera's axes (radians), then translation along them (map units).
    #[serde(skip_serializing_if = "Option::is_none")]
    covariance: Option<[[f64; 6]; 6]>,
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
    error: Option<String>,
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
    let map = MapFile::open(&args.map)?;
    let options = args.matching.options(&args.pose);
    let bar = ui.bar("Localizing", args.queries.len() as u64);
    let mut queries = Vec::new();
    for path in &args.queries {
        let query = SealedQuery::decode(&files::read(path)?).map_err(|e| {
            Failure::with_help(
                format!("{}: {e}", path.display()),
                "seal the image again with `veiloc seal`, and send the file unchanged",
            )
        })?;
        let file = path.display().to_string();
        queries.push(match localize(&query, &map, &options) {
            Ok(found) => found_query(file, &found),
            Err(error) => lost_query(file, &error.to_string()),
        });
        bar.inc(1);
    }
    bar.finish_and_clear();
    let localized = queries.iter().filter(|q| q.cam_from_world.is_some()).count();
    let document = Document { version: 1, map: args.map.display().to_string(), localized, queries };
    if args.json {
        ui.json(&document)?;
    } else {
        ui.print(table(&document));
    }
    Ok(if localized > 0 { Exit::Success } else { Exit::Refused })
}

fn found_query(file: String, found: &Localization) -> Query {
    let pose = &found.cam_from_world;
    let c = pose.center().coords;
    Query {
        file,
        cam_from_world: Some(PoseDocument::of(pose)),
        center: Some([c.x, c.y, c.z]),
        covariance: Some(found.covariance),
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

fn lost_query(file: String, error: &str) -> Query {
    Query {
        file,
        cam_from_world: None,
        center: None,
        covariance: None,
        trusted: false,
        doubts: Vec::new(),
        confidence: None,
        inliers: 0,
        matches: 0,
        hypotheses: 0,
        ms: BTreeMap::new(),
        error: Some(error.to_owned()),
    }
}

fn table(document: &Document) -> String {
    use std::fmt::Write as _;
    let width = document.queries.iter().map(|q| q.file.chars().count()).max().unwrap_or(0);
    let mut text = String::new();
    for q in &document.queries {
        let _ = match (&q.center, &q.error) {
            (Some([x, y, z]), _) => {
                let sigma = q.covariance.map_or(f64::NAN, |c| (c[3][3] + c[4][4] + c[5][5]).sqrt());
                let total: f64 = q.ms.values().sum();
                writeln!(
                    text,
                    "{:<width$}  at ({x:.3}, {y:.3}, {z:.3}) ± {sigma:.4}  {} of {} matches agree  {total:.0} ms{}",
                    q.file,
                    q.inliers,
                    q.matches,
                    if q.trusted { String::new() } else { format!("  DOUBTFUL: {}", q.doubts.join("; ")) },
                )
            }
            (None, error) => {
                writeln!(text, "{:<width$}  {}", q.file, error.as_deref().unwrap_or("not localized"))
            }
        };
    }
    text
}
