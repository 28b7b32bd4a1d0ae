//! `veiloc eval sessions`: what several frames of one place give away, by what their anchors are tied to.

use std::num::NonZeroUsize;

use veiloc_evaluation::privacy::sessions::{Motion, SessionsEvaluation, evaluate_sessions, table};
use veiloc_obfuscation::{SessionAnchors, SessionOptions};

use crate::commands::eval::scene::SceneArgs;
use crate::exit::{Exit, Outcome};
use crate::stages::Stages;
use crate::ui::Ui;

/// Several frames of one place, attacked together by a server that has localized each.
///
/// Builds a map from the images of the map list. The images of the query list are the frames of one walk; a device seals
/// them in one session, with anchors tied to the image, the world or gravity, and a server puts some of them together.
/// Attacked are a region like a person, of which the map knows nothing, and the keypoints that the map knows, as if it did
/// not. The first table says what the single frames are worth.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// What anchors are tied to: image, world, gravity.
    #[arg(long, value_delimiter = ',', default_value = "image,world,gravity", value_name = "ANCHORS,…")]
    anchors: Vec<SessionAnchors>,
    /// How the frames that are put together came about: turning (those of the walk that tell most), walking (those before
    /// the attacked one), resting (the same image with new noise of the sensor), visiting (as turning, each frame in a session
    /// of its own).
    #[arg(long, value_delimiter = ',', default_value = "turning,walking,resting", value_name = "MOTION,…")]
    motion: Vec<Motion>,
    /// Frames put together, the attacked one included.
    #[arg(long, value_delimiter = ',', default_value = "2,3,5,8", value_name = "N,…")]
    frames: Vec<NonZeroUsize>,
    /// Standard deviation of each orientation's own error about each axis, degrees.
    #[arg(long, value_delimiter = ',', default_value = "0,0.1,0.5", value_name = "DEG,…")]
    gyro_deg: Vec<f64>,
    /// Standard deviation by which the orientation drifts about each axis from a frame to the next, degrees.
    #[arg(long, value_delimiter = ',', default_value = "0", value_name = "DEG,…")]
    drift_deg: Vec<f64>,
    /// Attack N images only, spread evenly. Default: all that have frames enough.
    #[arg(long, value_name = "N")]
    attacked: Option<NonZeroUsize>,
    /// Share of an image's keypoints that the region like a person holds.
    #[arg(long, default_value_t = 0.1, value_name = "SHARE")]
    private: f64,
    /// Queries farther apart than this are not of one walk, map units.
    #[arg(long, default_value_t = 0.5, value_name = "T")]
    reach: f64,
    /// Standard deviation of the sensor's noise in frames of a camera at rest, grey levels of 255.
    #[arg(long, default_value_t = 2.0, value_name = "LEVELS")]
    sensor_noise: f64,
    /// Width of the band along borders of sectors that sessions leave out, degrees. Default: as devices do.
    #[arg(long, value_name = "DEG")]
    band: Option<f64>,
    /// Width of the cells that sessions tell angles on, radians; 0 dithers each frame anew. Default: as devices do.
    #[arg(long, value_name = "RAD")]
    step: Option<f64>,
    /// Let sessions forget what they told of which keypoint.
    #[arg(long)]
    no_memory: bool,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let default = SessionOptions::default();
    let evaluation = SessionsEvaluation {
        place: args.scene.evaluation()?,
        anchors: args.anchors.clone(),
        motions: args.motion.clone(),
        frames: args.frames.iter().map(|n| n.get()).collect(),
        gyro_deg: args.gyro_deg.clone(),
        drift_deg: args.drift_deg.clone(),
        attacked: args.attacked.map(NonZeroUsize::get),
        private: args.private,
        reach: args.reach,
        sensor_noise: args.sensor_noise,
        session: default
            .with_band_deg(args.band.unwrap_or(default.band_deg))
            .with_step(args.step.unwrap_or(default.step))
            .with_memory(default.memory && !args.no_memory),
    };
    let document = evaluate_sessions(&evaluation, &Stages::new(ui))?;
    ui.say(format!("map: {} images, {} points", document.map.images, document.map.points));
    args.scene.report.print(&table(&document), &document, ui)?;
    let localized = document.frames.iter().any(|f| f.summary.localized > 0);
    Ok(if localized { Exit::Success } else { Exit::Refused })
}
