//! `veiloc eval pose`: the pose stage alone, compared over schemes, recipes, effort, gravity and seeds.

use std::path::PathBuf;

use veiloc_evaluation::pose::{GravitySource, PoseEvaluation, Recipe, evaluate_poses};
use veiloc_evaluation::results::Hypotheses;
use veiloc_protocol::AngleBits;

use crate::commands::eval::report::ReportArgs;
use crate::exit::Outcome;
use crate::localization_args::{EngineArgs, RunArgs, positive};
use crate::stages::Stages;
use crate::ui::Ui;

/// The pose stage alone, on matches that are already there.
///
/// Every query's keypoints are obfuscated on reading, so that all schemes see the very same matches. A query without
/// a pose counts as infinitely wrong.
#[derive(clap::Args)]
#[command(after_long_help = RECIPES)]
pub(crate) struct Args {
    /// Problems, one JSON object a line, plain or gzipped.
    #[arg(required = true, value_name = "PROBLEMS")]
    files: Vec<PathBuf>,
    /// Named ways of estimating to compare: paper, likelihood, likelihood+prior, vote, default, optimum, floor. They set score,
    /// solver and prior together; see below. Default: none, single options count.
    #[arg(long, value_delimiter = ',', value_name = "RECIPE,…", conflicts_with_all = ["score", "scores", "solver", "no_prior"])]
    recipes: Vec<Recipe>,
    /// Add the floor: least squares from the true pose on the truly right matches.
    #[arg(long)]
    oracle: bool,
    /// A match is truly right when its map point projects this near to the keypoint under the true pose, pixels.
    #[arg(long, default_value_t = 4.0, value_name = "PX", value_parser = positive)]
    oracle_radius: f64,
    /// Numbers of hypotheses to compare; `adaptive` stops when a better one is unlikely.
    #[arg(long, value_delimiter = ',', default_value = "adaptive", value_name = "N,…")]
    hypotheses: Vec<Hypotheses>,
    /// What to tell about gravity: `file` (what the problems bring), `none`, or the true direction turned by so many
    /// degrees towards a random side.
    #[arg(long, value_delimiter = ',', default_value = "file", value_name = "GRAVITY,…")]
    gravity: Vec<GravitySource>,
    /// Repeat with so many seeds, from `--seed` upwards; the table then shows the mean over seeds, and below it the
    /// smallest and the largest.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: u64,
    /// Queries estimated at the same time. With more than one the times of a query are those of a busy machine.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: u16,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    engine: EngineArgs,
    #[command(flatten)]
    run: RunArgs,
    /// Bits of a line's angle, as a profile sets them.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u8).range(6..=16))]
    angle_bits: u8,
}

const RECIPES: &str = "\
Recipes (points are always sampled with p3p, lines of any direction with p6lp, or with the gravity solvers):
  paper             MSAC; for dcl p6lp; all matches weighed alike
  likelihood        the likelihood in place of MSAC
  likelihood+prior  the same, matches weighed by ratio, votes and track length
  vote              the same, for dcl with the radial vote
  default           the engine as it is shipped, with prior
  optimum           the engine's own optimum from the true pose: what a search that misses nothing finds
  floor             least squares from the true pose on the truly right matches

Problems may hold gravity_in_camera, the direction in which things fall as the camera feels it (+y for an upright
camera), and gravity_in_world, the same direction in the map (default 0,0,-1). `--gravity DEG` takes the mean of the
true cameras' down axes of a file for the world's down.";

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
