//! `veiloc eval rig`: localizes sessions of several images of a scene with known poses.

use std::num::NonZeroUsize;

use veiloc_evaluation::stress::StressCondition;
use veiloc_evaluation::{RigEvaluation, evaluate_rig};

use crate::commands::eval::posed_scene::with_remedy;
use crate::commands::eval::scene::SceneArgs;
use crate::exit::{Failure, Outcome};
use crate::stages::Stages;
use crate::ui::Ui;

/// Localize several consecutive images together, with simulated odometry.
///
/// Builds a map from the images of the map list. Every query is then the newest image of a session that also has the
/// preceding images of the list; their relative poses are the true ones with noise at every step. A row of the table is
/// a scheme and a number of images; errors are those of the newest image's pose. A session without a pose counts as
/// infinite error.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Images per session; one row of the table for each number.
    #[arg(long, value_delimiter = ',', default_value = "1,2,4,8", value_name = "N,…")]
    frames: Vec<NonZeroUsize>,
    /// Standard deviation of the odometry error about each axis per step, degrees.
    #[arg(long, default_value_t = 0.1, value_name = "DEG")]
    rotation_noise: f64,
    /// Standard deviation of the odometry error along each axis per step, map units.
    #[arg(long, default_value_t = 0.01, value_name = "T")]
    translation_noise: f64,
    /// Maximum distance between consecutive queries of one trajectory, map units.
    #[arg(long, default_value_t = 0.5, value_name = "T")]
    max_distance: f64,
    /// Stress condition of all queries, as in `eval stress`: none, dark, motion, half-hidden, side-hidden,
    /// low-resolution, sparse-map, few-keypoints or focal-N.
    #[arg(long, default_value_t = StressCondition::None, value_name = "STRESS")]
    stress: StressCondition,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    if args.scene.estimator.estimator()?.score() != veiloc_pose::ScoreKind::Likelihood {
        return Err(Failure::with_help(
            "sessions are localized with the likelihood only",
            "give an --estimator with the likelihood",
        ));
    }
    let evaluation = RigEvaluation {
        scene: args.scene.evaluation(ui)?,
        frames: args.frames.iter().map(|n| n.get()).collect(),
        rotation_sd_deg: args.rotation_noise,
        translation_sd: args.translation_noise,
        max_distance: args.max_distance,
        stress: args.stress,
    };
    let result = evaluate_rig(&evaluation, &Stages::new(ui)).map_err(with_remedy)?;
    if let Some(map) = &result.map {
        ui.info(format!("map: {} images, {} points", map.images, map.points));
    }
    args.scene.report.finish(&result, ui)
}
