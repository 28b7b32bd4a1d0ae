//! `veiloc eval`: measures localization on data with known poses.

mod adversaries;
mod data_set;
pub(crate) mod html;
mod inversion;
mod keypoints;
mod negatives;
mod pack;
mod pairs;
mod pose;
mod posed_scene;
mod problems;
mod report;
mod scene;
mod sessions;

use crate::output::exit::Outcome;
use crate::output::ui::Ui;

/// What to evaluate.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// Run the whole pipeline on a scene with known poses: build the map, seal the queries, localize them; also under
    /// hard conditions, with several images together, and with out-of-map images.
    Scene(Box<scene::Args>),
    /// Evaluate the scenes of 7Scenes, Cambridge Landmarks or Aachen Day-Night, from the unpacked folders.
    Dataset(Box<data_set::Args>),
    /// Attack several frames of one scene together, and report what a session leaks for each kind of anchors.
    Sessions(Box<sessions::Args>),
    /// Run only the pose stage, on given matches.
    Pose(pose::Args),
    /// Write correspondence sets of a scene with known poses, for `eval pose`.
    Problems(problems::Args),
    /// Report what each adversary recovers from the queries of every scheme, with its best attack.
    Adversaries(Box<adversaries::Args>),
    /// Reconstruct images from recovered keypoints under every scheme, and compare them with the originals.
    Inversion(Box<inversion::Args>),
    /// Extract keypoints and descriptors of images, for `attack` and for training predictors.
    Keypoints(keypoints::Args),
    /// Look up the keypoints of images in the pack of a place: which of them a device with this pack sends.
    Pack(pack::Args),
}

/// Runs a command of `veiloc eval`.
///
/// # Errors
/// An input cannot be read, the inputs contradict each other, or results cannot be written.
pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Scene(args) => scene::run(args, ui),
        Command::Dataset(args) => data_set::run(args, ui),
        Command::Sessions(args) => sessions::run(args, ui),
        Command::Pose(args) => pose::run(args, ui),
        Command::Problems(args) => problems::run(args, ui),
        Command::Adversaries(args) => adversaries::run(args, ui),
        Command::Inversion(args) => inversion::run(args, ui),
        Command::Keypoints(args) => keypoints::run(args, ui),
        Command::Pack(args) => pack::run(args, ui),
    }
}
