//! `veiloc eval sessions`: leaks of several frames of one scene, for each kind of anchors.

use std::num::NonZeroUsize;

use veiloc_evaluation::attack_evaluation::sessions::{Motion, SessionsEvaluation, evaluate_sessions, table};
use veiloc_obfuscation::{PackUse, SessionAnchors, SessionOptions};

use crate::commands::eval::posed_scene::with_remedy;
use crate::commands::eval::scene::SceneArgs;
use crate::output::exit::{Exit, Outcome};
use crate::output::stages::Stages;
use crate::output::ui::Ui;

/// Attack several frames of one scene together, as a server that has localized each frame.
///
/// Builds a map from the images of the map list. The images of the query list are the frames of one trajectory; a
/// device seals them in one session, with anchors fixed to the image, the world or gravity, and a server combines some
/// of them. The attack targets a region the size of a person that the map does not contain, and the keypoints that the
/// map contains, without their known positions. The first table shows the attack on single frames.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Frame that anchors are fixed to: image, world, gravity.
    #[arg(long, value_delimiter = ',', default_value = "image,world,gravity", value_name = "ANCHORS,…")]
    anchors: Vec<SessionAnchors>,
    /// Origin of the combined frames: turning (the frames of the trajectory that give the most information), walking
    /// (the frames before the attacked one), static (the same image with new sensor noise), visiting (as turning, but
    /// each frame in a session of its own).
    #[arg(long, value_delimiter = ',', default_value = "turning,walking,static", value_name = "MOTION,…")]
    motion: Vec<Motion>,
    /// Number of combined frames, including the attacked one.
    #[arg(long, value_delimiter = ',', default_value = "2,3,5,8", value_name = "N,…")]
    frames: Vec<NonZeroUsize>,
    /// Standard deviation of each orientation's own error about each axis, degrees.
    #[arg(long, value_delimiter = ',', default_value = "0,0.1,0.5", value_name = "DEG,…")]
    gyro_deg: Vec<f64>,
    /// Standard deviation of the orientation drift about each axis per frame, degrees.
    #[arg(long, value_delimiter = ',', default_value = "0", value_name = "DEG,…")]
    drift_deg: Vec<f64>,
    /// Attack only N images, evenly spaced. Default: all that have enough frames.
    #[arg(long, value_name = "N")]
    max_attacked: Option<NonZeroUsize>,
    /// Share of an image's keypoints in the region the size of a person.
    #[arg(long, default_value_t = 0.1, value_name = "SHARE")]
    private: f64,
    /// Maximum distance between consecutive queries of one trajectory, map units.
    #[arg(long, default_value_t = 0.5, value_name = "T")]
    max_distance: f64,
    /// Standard deviation of the sensor noise in frames of a static camera, grey levels of 255.
    #[arg(long, default_value_t = 2.0, value_name = "LEVELS")]
    sensor_noise: f64,
    /// Width of the band along sector borders whose keypoints sessions leave out, degrees. Default: as on devices.
    #[arg(long, value_name = "DEG")]
    band: Option<f64>,
    /// Quantization step of angles in a session, radians; 0 dithers each frame anew. Default: as on devices.
    #[arg(long, value_name = "RAD")]
    step: Option<f64>,
    /// The device has the pack of the map, and sends this with it: matches or explained. Default: no pack.
    #[arg(long, value_name = "WHAT")]
    send: Option<PackUse>,
    /// Do not let sessions remember what was sent of each keypoint.
    #[arg(long)]
    no_memory: bool,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    args.scene.estimator.estimator()?;
    let default = SessionOptions::default();
    let evaluation = SessionsEvaluation {
        scene: args.scene.evaluation(ui)?,
        anchors: args.anchors.clone(),
        motions: args.motion.clone(),
        frames: args.frames.iter().map(|n| n.get()).collect(),
        gyro_deg: args.gyro_deg.clone(),
        drift_deg: args.drift_deg.clone(),
        attacked: args.max_attacked.map(NonZeroUsize::get),
        private: args.private,
        max_distance: args.max_distance,
        sensor_noise: args.sensor_noise,
        session: default
            .with_band_deg(args.band.unwrap_or(default.band_deg))
            .with_step(args.step.unwrap_or(default.step))
            .with_memory(default.memory && !args.no_memory),
        pack: args.send,
    };
    let document = evaluate_sessions(&evaluation, &Stages::new(ui)).map_err(with_remedy)?;
    ui.info(format!("map: {} images, {} points", document.map.images, document.map.points));
    args.scene.report.print(&table(&document), &document, ui)?;
    let localized = document.frames.iter().any(|f| f.summary.localized > 0);
    Ok(if localized { Exit::Success } else { Exit::Refused })
}
