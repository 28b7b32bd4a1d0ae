//! `veiloc eval rig`: sessions of several images on a place with known poses.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use veiloc_eval::stress::Stress;
use veiloc_eval::{RigEvaluation, SceneEvaluation, evaluate_rig};
use veiloc_map::colmap::read_posed;

use crate::commands::eval::place::PlaceArgs;
use crate::commands::eval::report::ReportArgs;
use crate::commands::localization_args::{MatchArgs, PoseArgs};
use crate::commands::map::ExtractionArgs;
use crate::exit::{Failure, Outcome};
use crate::lists;
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
    place: PlaceArgs,
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

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let scores = args.report.scores(&args.pose.engine);
    if scores.iter().any(|score| *score != veiloc_robust::ScoreKind::Likelihood) {
        return Err(Failure::with_help(
            "sessions are localized with the likelihood only",
            "leave --score and --scores away",
        ));
    }
    let queries = lists::read_with_cameras(&args.place.query_list)?;
    let place = SceneEvaluation {
        posed: read_posed(&args.place.posed)?,
        images: args.place.images.clone(),
        map_list: lists::read_list(&args.place.map_list)?,
        query_list: queries.iter().map(|q| q.name.clone()).collect(),
        query_cameras: queries.into_iter().filter_map(|q| Some((q.name, q.camera?))).collect(),
        keep_map: args.keep_map.clone(),
        build: args.extraction.options(),
        schemes: args.report.schemes.clone(),
        scores,
        thresholds: args.report.thresholds.clone(),
        localize: args.matching.options(&args.pose),
        negatives: None,
        gravity_sd_deg: None,
        seed: args.pose.run.seed,
    };
    let evaluation = RigEvaluation {
        place,
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
    args.report.finish(&result, ui)
}
