//! `veiloc eval`: localization measured on data with known poses, and against what theory allows.

mod adversaries;
mod compare;
mod crb;
mod data_set;
mod half;
pub(crate) mod html;
mod inversion;
mod keypoints;
mod layouts;
mod negatives;
mod place;
mod pose;
mod problems;
mod report;
mod rig;
mod scene;
mod search;
mod sessions;
mod stress;
mod tables;

use crate::exit::Outcome;
use crate::ui::Ui;

/// What to evaluate.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// The whole road on a place with known poses: build the map, seal the queries, localize them.
    Scene(Box<scene::Args>),
    /// 7Scenes: all its scenes, from the folders as they are unpacked.
    #[command(name = "7scenes")]
    SevenScenes(Box<data_set::seven_scenes::Args>),
    /// Cambridge Landmarks: its scenes.
    Cambridge(Box<data_set::cambridge::Args>),
    /// Aachen Day-Night, v1 and v1.1, with the file for visuallocalization.net.
    Aachen(Box<data_set::aachen::Args>),
    /// Tables as papers print them, of what a data set's command or `eval scene` found.
    Tables(tables::Args),
    /// One place, and queries of it in the dark, moved, half hidden, small, in a sparse map, with few keypoints.
    Stress(Box<stress::Args>),
    /// Images of elsewhere, asked for their place in a map: how many get a pose that is trusted.
    Negatives(Box<negatives::Args>),
    /// Finding the images of a map that look like a query: what it costs and misses, as maps grow.
    Search(search::Args),
    /// Several images in a row together, with simulated odometry: what a session gains over single images.
    Rig(Box<rig::Args>),
    /// Several frames of one place, attacked together: what a session gives away, by what its anchors are tied to.
    Sessions(Box<sessions::Args>),
    /// The pose stage alone, on matches that are already there.
    Pose(pose::Args),
    /// Errors on random synthetic problems over what the Cramér–Rao bound allows.
    Crb(crb::Args),
    /// Correspondence sets from a place with known poses, as `eval pose` reads them.
    Problems(problems::Args),
    /// What each adversary gets from the queries of every scheme, by the best of their attacks.
    Adversaries(Box<adversaries::Args>),
    /// Layouts of dcl: how exact poses are beside those of points, and what attackers get out of each.
    Layouts(Box<layouts::Args>),
    /// Two runs on the same queries, and which of their differences are more than chance.
    Compare(compare::Args),
    /// Images made of what attacks recover from queries, and how alike they are to those they were made of.
    Inversion(Box<inversion::Args>),
    /// Keypoints and descriptors of images, as `attack` and the training of predictors read them.
    Keypoints(keypoints::Args),
}

/// Runs one of `veiloc eval`.
///
/// # Errors
/// What was given cannot be read, or makes no sense together; results cannot be written.
pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Scene(args) => scene::run(args, ui),
        Command::SevenScenes(args) => data_set::seven_scenes::run(args, ui),
        Command::Cambridge(args) => data_set::cambridge::run(args, ui),
        Command::Aachen(args) => data_set::aachen::run(args, ui),
        Command::Tables(args) => tables::run(args, ui),
        Command::Stress(args) => stress::run(args, ui),
        Command::Negatives(args) => negatives::run(args, ui),
        Command::Search(args) => search::run(args, ui),
        Command::Rig(args) => rig::run(args, ui),
        Command::Sessions(args) => sessions::run(args, ui),
        Command::Pose(args) => pose::run(args, ui),
        Command::Crb(args) => crb::run(args, ui),
        Command::Problems(args) => problems::run(args, ui),
        Command::Adversaries(args) => adversaries::run(args, ui),
        Command::Layouts(args) => layouts::run(args, ui),
        Command::Compare(args) => compare::run(args, ui),
        Command::Inversion(args) => inversion::run(args, ui),
        Command::Keypoints(args) => keypoints::run(args, ui),
    }
}
