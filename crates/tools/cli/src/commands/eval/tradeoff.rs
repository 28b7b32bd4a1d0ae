//! `veiloc eval tradeoff`: variants of dcl between privacy and recall.

use std::path::PathBuf;

use veiloc_evaluation::privacy::variants::{TradeoffEvaluation, Variant, evaluate_tradeoff, tradeoff_table};
use veiloc_evaluation::results::metrics::Threshold;
use veiloc_report::plots;

use crate::exit::{Exit, Outcome};
use crate::files;
use crate::json_args::JsonArgs;
use crate::localization_args::{EngineArgs, RunArgs};
use crate::stages::Stages;
use crate::ui::Ui;

/// Variants of dcl: what attackers get out of each, and the poses it still gives.
///
/// Reads all keypoints of images and the matches of the same images, as `eval problems --keypoints` writes them.
/// Each variant is a change of what a device sends; the same rows are attacked and localized.
#[derive(clap::Args)]
#[command(after_long_help = VARIANTS)]
pub(crate) struct Args {
    /// All keypoints of images with descriptors, one JSON object a line, plain or gzipped.
    #[arg(value_name = "KEYPOINTS")]
    keypoints: PathBuf,
    /// Matches and true poses of the same images; images without are only searched for known positions.
    #[arg(value_name = "PROBLEMS")]
    problems: PathBuf,
    /// Variants, in the order of the table.
    #[arg(long, value_delimiter = ',', default_value = "dcl", value_name = "VARIANT,…")]
    variants: Vec<Variant>,
    /// Keypoints of more map images, from which `transfer` takes positions over.
    #[arg(long, value_name = "FILE")]
    map: Vec<PathBuf>,
    /// Keypoints that teach the predictor of neighbours; attacked images among them are left out. Without, nothing is
    /// predicted.
    #[arg(long, value_name = "FILE")]
    train: Vec<PathBuf>,
    /// Attack N images only, spread evenly; poses are estimated for all. Default: all.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    attacked: Option<u32>,
    /// Neighbours a keypoint.
    #[arg(short, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1000))]
    k: u32,
    /// Percent of the true neighbours that are replaced by keypoints drawn at random, one graph attack each.
    #[arg(long, value_delimiter = ',', default_value = "0,30,50", value_name = "PERCENT,…")]
    corrupt: Vec<f64>,
    /// Bounds of the recall columns, `translation/degrees` with the translation in map units; the plot shows the first.
    #[arg(long, value_delimiter = ',', default_value = "0.05/5", value_name = "T/DEG,…")]
    thresholds: Vec<Threshold>,
    /// Do not tell the estimator how much noise the variant adds.
    #[arg(long)]
    untold: bool,
    /// Seeds that poses are estimated with, from `--seed` upwards.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: u64,
    #[command(flatten)]
    engine: EngineArgs,
    #[command(flatten)]
    run: RunArgs,
    /// Draw recall over keypoints found into FILE, as SVG.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    json: JsonArgs,
}

const VARIANTS: &str = "\
Variants: dcl, or any of these joined by +
  known=R      only keypoints that match the map with a distance ratio of at most R
  gap=PX       none nearer than this to the dividing line
  crop=C       none beyond a share of its half-line that is drawn from C to 1 for each side
  spacing=PX   none nearer than this to one before it in the file
  cell=PX      the first in every square cell of this size
  first=N      the first N of the file (the strongest, where it is in order of strength)
  random=N        N drawn at random
  noise=PX     moved across the half-line by normal noise
  decoys=P     P percent more rows, decoys as a device invents them
  line=L       dividing line vertical, horizontal, or lot: drawn for every query
  s=S          anchors at S half image heights from the centre
  bits=B       angles of B bits, 6 to 16";

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let mut evaluation = TradeoffEvaluation::new(args.keypoints.clone(), args.problems.clone());
    evaluation.variants.clone_from(&args.variants);
    evaluation.map.clone_from(&args.map);
    evaluation.train.clone_from(&args.train);
    evaluation.attacked = args.attacked.map(|n| n as usize);
    evaluation.k = args.k as usize;
    evaluation.corrupt.clone_from(&args.corrupt);
    evaluation.thresholds.clone_from(&args.thresholds);
    evaluation.pose = args.engine.options();
    evaluation.use_prior = args.run.use_prior();
    evaluation.tell_noise = !args.untold;
    evaluation.seed = args.run.seed;
    evaluation.seeds = args.seeds;
    let document = evaluate_tradeoff(&evaluation, &Stages::new(ui))?;
    if let Some(path) = &args.plot {
        files::write(path, plots::tradeoff(&document)?.as_bytes())?;
    }
    args.json.print(&tradeoff_table(&document), &document, ui)?;
    let localized = document.variants.iter().any(|v| v.localization.localized > 0);
    Ok(if localized { Exit::Success } else { Exit::Refused })
}
