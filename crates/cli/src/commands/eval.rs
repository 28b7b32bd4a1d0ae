//! `veiloc eval`: localization measured on data with known poses.

use std::path::PathBuf;

use veiloc_eval::metrics::Threshold;
use veiloc_eval::results::{Evaluation, table};
use veiloc_eval::{PoseEvaluation, SceneEvaluation, evaluate_poses, evaluate_scene};
use veiloc_query::{AngleBits, Scheme};
use veiloc_robust::ScoreKind;

use crate::commands::localization_args::{MatchArgs, PoseArgs};
use crate::commands::map::ExtractionArgs;
use crate::exit::{Exit, Outcome};
use crate::files;
use crate::ui::{Bars, Ui};

/// What to evaluate.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// The whole road on a place with known poses: build the map, seal the queries, localize them.
    Scene(SceneArgs),
    /// The pose stage alone, on matches that are already there.
    Pose(ProblemArgs),
}

/// What both evaluations print.
#[derive(clap::Args)]
struct ReportArgs {
    /// Schemes to compare.
    #[arg(long, value_delimiter = ',', default_value = "points,random-lines,dcl", value_name = "SCHEME,…")]
    schemes: Vec<Scheme>,
    /// Scores to compare; each scheme is run with each. Default: one score, as `--score`.
    #[arg(long, value_delimiter = ',', value_name = "SCORE,…", conflicts_with = "score")]
    scores: Vec<ScoreKind>,
    /// Bounds of the recall columns, `translation/degrees` with the translation in map units.
    #[arg(long, value_delimiter = ',', default_value = "0.05/5,0.25/2", value_name = "T/DEG,…")]
    thresholds: Vec<Threshold>,
    /// Write the JSON document to FILE; without FILE, or with `-`, to stdout. Put it last when no FILE follows.
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-")]
    json: Option<PathBuf>,
}

impl ReportArgs {
    fn scores(&self, pose: &PoseArgs) -> Vec<ScoreKind> {
        match (self.scores.is_empty(), pose.score) {
            (false, _) => self.scores.clone(),
            (true, Some(score)) => vec![score],
            (true, None) => Vec::new(),
        }
    }

    fn finish(&self, evaluation: &Evaluation, ui: &Ui) -> Outcome {
        match &self.json {
            Some(path) if path.as_os_str() == "-" => {
                ui.say(table(&evaluation.schemes));
                ui.json(evaluation)?;
            }
            Some(path) => {
                files::write(path, (serde_json::to_string_pretty(evaluation)? + "\n").as_bytes())?;
                ui.print(table(&evaluation.schemes));
            }
            None => ui.print(table(&evaluation.schemes)),
        }
        let localized = evaluation.schemes.iter().any(|s| s.localized > 0);
        Ok(if localized { Exit::Success } else { Exit::Refused })
    }
}

/// The pose stage alone, on matches that are already there.
///
/// Every query's keypoints are obfuscated on reading, so that all schemes see the very same matches. A query without
/// a pose counts as infinitely wrong.
#[derive(clap::Args)]
pub(crate) struct ProblemArgs {
    /// Problems, one JSON object a line, plain or gzipped.
    #[arg(required = true, value_name = "PROBLEMS")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    pose: PoseArgs,
    /// Bits of a line's angle, as a profile sets them.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u8).range(6..=16))]
    angle_bits: u8,
}

/// The whole road on a place with known poses.
///
/// Builds a map from the images of the map list, seals every image of the query list under every scheme, localizes
/// it, and compares with its known pose. A query without a pose counts as infinitely wrong.
#[derive(clap::Args)]
pub(crate) struct SceneArgs {
    /// Folder of a COLMAP model with cameras and poses, text or binary; its points are not used.
    #[arg(long, value_name = "DIR")]
    posed: PathBuf,
    /// Folder of the photographs.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    /// Names of the images the map is built from, one a line.
    #[arg(long, value_name = "FILE")]
    map_list: PathBuf,
    /// Names of the images to localize, one a line.
    #[arg(long, value_name = "FILE")]
    query_list: PathBuf,
    /// Keep the map that was built.
    #[arg(long, value_name = "FILE")]
    keep_map: Option<PathBuf>,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    pose: PoseArgs,
    #[command(flatten)]
    matching: MatchArgs,
}

pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Scene(args) => scene(args, ui),
        Command::Pose(args) => pose(args, ui),
    }
}

fn pose(args: &ProblemArgs, ui: &Ui) -> Outcome {
    let evaluation = PoseEvaluation {
        files: args.files.clone(),
        schemes: args.report.schemes.clone(),
        scores: args.report.scores(&args.pose),
        thresholds: args.report.thresholds.clone(),
        pose: args.pose.options(),
        angle_bits: AngleBits::new(args.angle_bits)?,
        use_prior: args.pose.use_prior(),
        seed: args.pose.seed,
    };
    let bar = ui.bar("Estimating poses", 0);
    let result = evaluate_poses(&evaluation, |done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    args.report.finish(&result, ui)
}

fn scene(args: &SceneArgs, ui: &Ui) -> Outcome {
    let evaluation = SceneEvaluation {
        posed: args.posed.clone(),
        images: args.images.clone(),
        map_list: files::read_list(&args.map_list)?,
        query_list: files::read_list(&args.query_list)?,
        keep_map: args.keep_map.clone(),
        build: args.extraction.options(),
        schemes: args.report.schemes.clone(),
        scores: args.report.scores(&args.pose),
        thresholds: args.report.thresholds.clone(),
        localize: args.matching.options(&args.pose),
        seed: args.pose.seed,
    };
    let result = evaluate_scene(&evaluation, &Bars::new(ui))?;
    if let Some(map) = &result.map {
        ui.say(format!(
            "map: {} images, {} points, {:.1} MB ({:.0} bytes a point), built in {:.1} s ({:.2} s an image)",
            map.images,
            map.points,
            map.bytes as f64 / 1e6,
            map.bytes as f64 / map.points.max(1) as f64,
            map.build_seconds,
            map.build_seconds / map.images.max(1) as f64,
        ));
    }
    args.report.finish(&result, ui)
}
