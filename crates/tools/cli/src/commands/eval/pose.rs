//! `veiloc eval pose`: compares the pose stage over schemes, recipes, effort, gravity and seeds.

use std::path::PathBuf;

use veiloc_evaluation::pose::{GravitySource, PoseEvaluation, Recipe, evaluate_poses};
use veiloc_evaluation::results::Hypotheses;
use veiloc_protocol::AngleBits;

use crate::commands::eval::report::ReportArgs;
use crate::exit::Outcome;
use crate::localization_args::{EngineArgs, RunArgs, positive};
use crate::stages::Stages;
use crate::ui::Ui;

/// Run only the pose stage, on given matches.
///
/// Every query's keypoints are obfuscated on reading, so that all schemes use the same matches. A query without a pose
/// counts as infinite error.
#[derive(clap::Args)]
#[command(after_long_help = RECIPES)]
pub(crate) struct Args {
    /// Problems, one JSON object per line, plain or gzipped.
    #[arg(required = true, value_name = "PROBLEMS")]
    files: Vec<PathBuf>,
    /// Named configurations to compare: paper, likelihood, likelihood+prior, vote, default, optimum, floor. Each sets
    /// score, solver and prior; see below. Default: none; the single options apply.
    #[arg(long, value_delimiter = ',', value_name = "RECIPE,…", conflicts_with_all = ["score", "scores", "solver", "no_prior"])]
    recipes: Vec<Recipe>,
    /// Add the floor: least squares from the true pose on the correct matches.
    #[arg(long)]
    oracle: bool,
    /// A match is correct if its map point projects within this distance of the keypoint under the true pose, pixels.
    #[arg(long, default_value_t = 4.0, value_name = "PX", value_parser = positive)]
    oracle_radius: f64,
    /// Numbers of hypotheses to compare; `adaptive` stops when a better one is unlikely.
    #[arg(long, value_delimiter = ',', default_value = "adaptive", value_name = "N,…")]
    hypotheses: Vec<Hypotheses>,
    /// Gravity in the queries: `file` (as in the problems), `none`, or the true direction rotated by this number of
    /// degrees in a random direction.
    #[arg(long, value_delimiter = ',', default_value = "file", value_name = "GRAVITY,…")]
    gravity: Vec<GravitySource>,
    /// Number of seeds to repeat with, from `--seed` upwards; the table then shows the mean over seeds, and below it
    /// the minimum and the maximum.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: u64,
    /// Queries that are estimated in parallel. With more than one, times are those of a loaded machine.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: u16,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    engine: EngineArgs,
    #[command(flatten)]
    run: RunArgs,
    /// Bits of a line's angle, as set in a profile.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u8).range(6..=16))]
    angle_bits: u8,
}

const RECIPES: &str = "\
Recipes (points are always sampled with p3p, lines of any direction with p6lp, or with the gravity solvers):
  paper             MSAC; for dcl p6lp; equal match weights
  likelihood        the likelihood instead of MSAC
  likelihood+prior  the same, with match weights from ratio, votes and track length
  vote              the same, for dcl with the radial vote
  default           the default settings, with prior
  optimum           the engine's own optimum, started from the true pose: the result of a perfect search
  floor             least squares from the true pose on the correct matches

Problems may have gravity_in_camera, the direction of gravity in the camera frame (+y for an upright
camera), and gravity_in_world, the same direction in the map (default 0,0,-1). `--gravity DEG` uses the mean of the
true cameras' down axes of a file as the world's down.";

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let mut evaluation = PoseEvaluation::new(args.files.clone(), args.report.schemes.clone());
    evaluation.recipes.clone_from(&args.recipes);
    if args.oracle && !evaluation.recipes.contains(&Recipe::Floor) {
        evaluation.recipes.push(Recipe::Floor);
    }
    evaluation.oracle_radius_px = args.oracle_radius;
    evaluation.scores = args.report.scores(&args.engine);
    evaluation.hypotheses.clone_from(&args.hypotheses);
    evaluation.gravity.clone_from(&args.gravity);
    evaluation.thresholds.clone_from(&args.report.thresholds);
    evaluation.pose = args.engine.options();
    evaluation.angle_bits = AngleBits::new(args.angle_bits)?;
    evaluation.use_prior = args.run.use_prior();
    evaluation.seed = args.run.seed;
    evaluation.seeds = args.seeds;
    evaluation.threads = usize::from(args.threads);
    let result = evaluate_poses(&evaluation, &Stages::new(ui))?;
    args.report.finish(&result, ui)
}
