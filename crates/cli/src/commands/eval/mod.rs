//! `veiloc eval`: localization measured on data with known poses, and against what theory allows.

mod crb;
mod keypoints;
mod place;
mod pose;
mod problems;
mod report;
mod scene;
mod tradeoff;

use crate::exit::Outcome;
use crate::ui::Ui;

/// What to evaluate.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// The whole road on a place with known poses: build the map, seal the queries, localize them.
    Scene(Box<scene::Args>),
    /// The pose stage alone, on matches that are already there.
    Pose(pose::Args),
    /// Errors on random synthetic problems over what the Cramér–Rao bound allows.
    Crb(crb::Args),
    /// Correspondence sets from a place with known poses, as `eval pose` reads them.
    Problems(problems::Args),
    /// Variants of dcl: what attackers get out of each, and the poses it still gives.
    Tradeoff(tradeoff::Args),
    /// Keypoints and descriptors of images, as `attack` and the training of predictors read them.
    Keypoints(keypoints::Args),
}

pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Scene(args) => scene::run(args, ui),
        Command::Pose(args) => pose::run(args, ui),
        Command::Crb(args) => crb::run(args, ui),
        Command::Problems(args) => problems::run(args, ui),
        Command::Tradeoff(args) => tradeoff::run(args, ui),
        Command::Keypoints(args) => keypoints::run(args, ui),
    }
}
