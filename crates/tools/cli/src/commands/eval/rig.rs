//! `veiloc eval rig`: sessions of several images on a place with known poses.

use std::num::NonZeroUsize;

use veiloc_evaluation::stress::Stress;
use veiloc_evaluation::{RigEvaluation, evaluate_rig};

use crate::commands::eval::scene::SceneArgs;
use crate::exit::{Failure, Outcome};
use crate::stages::Stages;
use crate::ui::Ui;

/// Several images in a row together, with simulated odometry.
///
/// Builds a map from the images of the map list. Every query is then the newest image of a session with those before it
/// in the list; their relative poses are the true ones with noise at every step. A row of the table is a scheme and a
/// number of images; errors are those of the newest image's pose. A session without a pose counts as infinitely wrong.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Images of a session, a row of the table each.
    #[arg(long, value_delimiter = ',', default_value = "1,2,4,8", value_name = "N,…")]
    frames: Vec<NonZeroUsize>,
    /// Standard deviation of the odometry's error about each axis at every step, degrees.
    #[arg(long, default_value_t = 0.1, value_name = "DEG")]
    rotation_noise: f64,
    /// Standard deviation of the odometry's error along each axis at every step, map units.
    #[arg(long, default_value_t = 0.01, value_name = "T")]
    translation_noise: f64,
    /// Queries farther apart than this are not of one walk, map units.
    #[arg(long, default_value_t = 0.5, value_name = "T")]
    reach: f64,
    /// What all queries are put under, as in `eval stress`: none, dark, motion, half-hidden, side-hidden, low-resolution,
    /// sparse-map, few-keypoints or focal-N.
    #[arg(long, default_value_t = Stress::None, value_name = "STRESS")]
    stress: Stress,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let scores = args.scene.report.scores(&args.scene.pose.engine);
    if scores.iter().any(|score| *score != veiloc_pose::ScoreKind::Likelihood) {
        return Err(Failure::with_help(
            "sessions are localized with the likelihood only",
            "leave --score and --scores away",
        ));
    }
    let evaluation = RigEvaluation {
        place: args.scene.evaluation()?,
        frames: args.frames.iter().map(|n| n.get()).collect(),
        rotation_sd_deg: args.rotation_noise,
        translation_sd: args.translation_noise,
        reach: args.reach,
        stress: args.stress,
    };
    let result = evaluate_rig(&evaluation, &Stages::new(ui))?;
    if let Some(map) = &result.map {
        ui.say(format!("map: {} images, {} points", map.images, map.points));
    }
    args.scene.report.finish(&result, ui)
}
