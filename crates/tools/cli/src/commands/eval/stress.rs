//! `veiloc eval stress`: queries of one scene under hard conditions.

use veiloc_evaluation::SceneEvaluation;
use veiloc_evaluation::results::metrics::Threshold;
use veiloc_evaluation::stress::{StressCondition, StressEvaluation, evaluate_stress, table};
use veiloc_protocol::Scheme;

use crate::commands::eval::posed_scene::{GravityArgs, PosedSceneArgs, with_remedy};
use crate::exit::{Exit, Outcome};
use crate::extraction_args::ExtractionArgs;
use crate::json_args::JsonArgs;
use crate::localization_args::{EstimatorArgs, positive};
use crate::stages::Stages;
use crate::ui::Ui;

/// Localize queries of one scene under hard conditions, and report recall and trust.
///
/// Builds a map from the images of the map list, seals every image of the query list under every stress condition and
/// scheme, localizes it, and compares with its known pose. A query without a pose counts as infinite error.
#[derive(clap::Args)]
#[command(after_long_help = STRESSES)]
pub(crate) struct Args {
    #[command(flatten)]
    posed_scene: PosedSceneArgs,
    #[command(flatten)]
    gravity: GravityArgs,
    /// Stress conditions of the queries, see below; `none`, the unchanged images, is always the first row.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "dark,motion,half-hidden,side-hidden,low-resolution,sparse-map,few-keypoints",
        value_name = "STRESS,…"
    )]
    stress: Vec<StressCondition>,
    /// Schemes to compare.
    #[arg(long, value_delimiter = ',', default_value = "points,random-lines,dcl", value_name = "SCHEME,…")]
    schemes: Vec<Scheme>,
    /// Thresholds of the recall columns, `translation/degrees` with the translation in map units.
    #[arg(long, value_delimiter = ',', default_value = "0.05/5,0.25/2", value_name = "T/DEG,…")]
    thresholds: Vec<Threshold>,
    /// A pose beyond either threshold, `translation/degrees`, is wrong and must not be trusted.
    #[arg(long, default_value = "0.25/2", value_name = "T/DEG")]
    wrong_threshold: Threshold,
    /// Also start from the true pose: the engine's own optimum (the result of a perfect search), and the floor (least
    /// squares on the correct matches).
    #[arg(long)]
    optimum: bool,
    /// For --optimum: a match is correct if its map point projects within this distance of the keypoint under the true
    /// pose, pixels.
    #[arg(long, default_value_t = 4.0, value_name = "PX", value_parser = positive)]
    oracle_radius: f64,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    json: JsonArgs,
    #[command(flatten)]
    estimator: EstimatorArgs,
}

const STRESSES: &str = "\
Stress conditions (applied to the gray image before feature extraction, rounded to 8 bits again; random choices depend
on --seed, the name of the image and the name of the stress):
  dark            an eighth of the light: white is 500 instead of 4000 electrons, shot and readout noise (3 electrons)
  motion          motion blur over 13/640 of the longer side, in a random direction
  half-hidden     flat gray over one half, cut through the middle in a random direction
  side-hidden     flat gray over exactly the left or the right half, which may leave dcl only one of its two anchors
  low-resolution  reduced to 160 pixels along the longer side, enlarged to the old size
  sparse-map      a map of every tenth image of the map list, or more if fewer than four would remain
  few-keypoints   the device sends 256 rows, the smallest size class
  focal-N         the device assumes a focal length N percent too long or too short, and declares it calibrated
                  (N from 1 to 50; only if given)";

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let mut evaluation = StressEvaluation::new(SceneEvaluation {
        build: args.extraction.options()?,
        schemes: args.schemes.clone(),
        thresholds: args.thresholds.clone(),
        estimators: vec![args.estimator.estimator()?],
        gravity: args.gravity.gravity_noise,
        seed: args.estimator.seed,
        ..args.posed_scene.scene(true, ui)?
    });
    evaluation.stresses.clone_from(&args.stress);
    evaluation.wrong_threshold = args.wrong_threshold;
    evaluation.from_truth = args.optimum;
    evaluation.oracle_radius_px = args.oracle_radius;
    let result = evaluate_stress(&evaluation, &Stages::new(ui)).map_err(with_remedy)?;
    ui.info(format!("map: {} images, {} points", result.map.images, result.map.points));
    if let Some(sparse) = &result.sparse_map {
        ui.info(format!(
            "sparse map: one image in {}, {} images, {} points",
            sparse.stride, sparse.map.images, sparse.map.points
        ));
    }
    args.json.print(&table(&result), &result, ui)?;
    let localized = result.rows.iter().any(|row| row.trusted + row.doubtful > 0);
    Ok(if localized { Exit::Success } else { Exit::Refused })
}
