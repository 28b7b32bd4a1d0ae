//! `veiloc eval pose`: compares the pose stage over schemes, estimators, gravity and seeds.

use std::path::PathBuf;

use veiloc_evaluation::pose::{GravitySource, PoseEvaluation, evaluate_poses};
use veiloc_protocol::AngleBits;

use crate::args::localization_args::{EstimatorArgs, positive};
use crate::commands::eval::report::ReportArgs;
use crate::output::exit::Outcome;
use crate::output::stages::Stages;
use crate::output::ui::Ui;

/// Run only the pose stage, on given matches.
///
/// Every query's keypoints are obfuscated on reading, so that all schemes use the same matches. A query without a pose
/// counts as infinite error.
#[derive(clap::Args)]
#[command(after_long_help = POSES)]
pub(crate) struct Args {
    /// Problems, one JSON object per line, plain or gzipped.
    #[arg(required = true, value_name = "PROBLEMS")]
    files: Vec<PathBuf>,
    /// For the estimator `floor`: a match is correct if its map point projects within this distance of the keypoint under the true pose, pixels.
    #[arg(long, default_value_t = 4.0, value_name = "PX", value_parser = positive)]
    oracle_radius: f64,
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
    estimator: EstimatorArgs,
    /// Bits of a line's angle, as set in a profile.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u8).range(6..=16))]
    angle_bits: u8,
}

const POSES: &str = "\
Estimators of this command, beside those of the others:
  optimum  the default's own optimum, started from the true pose: the result of a perfect search
  floor    least squares from the true pose on the correct matches

Problems may have gravity_in_camera, the direction of gravity in the camera frame (+y for an upright
camera), and gravity_in_world, the same direction in the map (default 0,0,-1). `--gravity DEG` uses the mean of the
true cameras' down axes of a file as the world's down.";

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let mut evaluation = PoseEvaluation::new(args.files.clone(), args.report.schemes.clone());
    evaluation.estimators = args.estimator.all()?;
    evaluation.oracle_radius_px = args.oracle_radius;
    evaluation.gravity.clone_from(&args.gravity);
    evaluation.thresholds.clone_from(&args.report.thresholds);
    evaluation.angle_bits = AngleBits::new(args.angle_bits)?;
    evaluation.seed = args.estimator.seed;
    evaluation.seeds = args.seeds;
    evaluation.threads = usize::from(args.threads);
    let result = evaluate_poses(&evaluation, &Stages::new(ui))?;
    args.report.finish(&result, ui)
}
