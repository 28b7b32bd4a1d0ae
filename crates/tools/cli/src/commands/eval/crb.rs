//! `veiloc eval crb`: errors on synthetic problems relative to the Cramér–Rao bound.

use veiloc_evaluation::pose::crb::{SyntheticEvaluation, SyntheticScene, evaluate_bound, table};
use veiloc_evaluation::results::Hypotheses;
use veiloc_protocol::{AngleBits, Scheme};
use veiloc_report::plots;

use crate::exit::{Exit, Outcome};
use crate::files;
use crate::json_args::JsonArgs;
use crate::localization_args::{EngineArgs, positive};
use crate::stages::Stages;
use crate::targets::OutFile;
use crate::ui::Ui;

/// Report errors on random synthetic problems relative to the Cramér–Rao bound.
///
/// Every problem has matches all over a 640 × 480 image, some of them wrong, and Gaussian noise on its keypoints. The
/// bound covers that noise and the dither and rounding of the obfuscation, and only the correct matches. A second table
/// reports how often the true pose lies in the confidence region of the estimated covariance.
#[derive(clap::Args)]
#[command(after_long_help = SCENES)]
pub(crate) struct Args {
    /// Scenes: deep, near-planar, narrow.
    #[arg(long, value_delimiter = ',', default_value = "deep,near-planar,narrow", value_name = "SCENE,…")]
    scenes: Vec<SyntheticScene>,
    /// Schemes to compare.
    #[arg(long, value_delimiter = ',', default_value = "points,random-lines,dcl", value_name = "SCHEME,…")]
    schemes: Vec<Scheme>,
    /// Standard deviations of a keypoint along each axis, pixels.
    #[arg(long, value_delimiter = ',', default_value = "0.5,1,2", value_name = "PX,…", value_parser = positive)]
    keypoint_noise: Vec<f64>,
    /// Outlier ratios, percent.
    #[arg(long, value_delimiter = ',', default_value = "30,50,80", value_name = "PERCENT,…", value_parser = percent)]
    outliers: Vec<f64>,
    /// Random problems per row; the median of 500 is accurate to about 4 %.
    #[arg(long, default_value_t = 500, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    problems: u32,
    /// Matches per problem.
    #[arg(long, default_value_t = 400, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    matches: u32,
    /// Number of hypotheses; `adaptive` stops when a better one is unlikely.
    #[arg(long, value_name = "N", default_value = "adaptive")]
    hypotheses: Hypotheses,
    #[command(flatten)]
    engine: EngineArgs,
    /// Bits of a line's angle, as set in a profile.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u8).range(6..=16))]
    angle_bits: u8,
    /// Seed of every random choice; equal seeds give equal results.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// Plot the translation errors relative to the bound into FILE, as SVG.
    #[arg(long, value_name = "FILE")]
    plot: Option<OutFile>,
    #[command(flatten)]
    json: JsonArgs,
}

const SCENES: &str = "\
Scenes (depths in map units):
  deep          field of view 63 degrees, depths 2 to 12
  near-planar   field of view 63 degrees, points within 0.05 of a slanted plane 4 away
  narrow        field of view 20 degrees, depths 2 to 6";

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let mut evaluation = SyntheticEvaluation::default();
    evaluation.scenes.clone_from(&args.scenes);
    evaluation.schemes.clone_from(&args.schemes);
    evaluation.noises_px.clone_from(&args.keypoint_noise);
    evaluation.outlier_shares = args.outliers.iter().map(|percent| percent / 100.0).collect();
    evaluation.problems = args.problems as usize;
    evaluation.matches = args.matches as usize;
    evaluation.pose = args.engine.options();
    evaluation.pose.fixed_hypotheses = args.hypotheses.fixed();
    evaluation.angle_bits = AngleBits::new(args.angle_bits)?;
    evaluation.seed = args.seed;
    let document = evaluate_bound(&evaluation, &Stages::new(ui))?;
    args.json.print(&table(&document), &document, ui)?;
    if let Some(path) = &args.plot {
        files::write(path, plots::bound(&document)?.as_bytes())?;
    }
    let localized = document.cells.iter().any(|cell| cell.localized > 0.0);
    Ok(if localized { Exit::Success } else { Exit::Refused })
}

/// Parses an outlier ratio below 100 percent.
fn percent(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if (0.0..100.0).contains(&value) {
        Ok(value)
    } else {
        Err("a percentage from 0 to below 100 is expected".to_owned())
    }
}
