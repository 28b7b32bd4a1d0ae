//! `veiloc map`: build, import, inspect, change, compress, split, publish and export maps.

mod add;
mod align;
mod alignment;
pub(crate) mod anchors;
mod build;
mod compress;
mod coordinate_frame;
mod edit;
mod export;
pub(crate) mod facts;
mod import;
mod info;
mod merge;
mod output_args;
mod pack;
mod posed_args;
mod profile;
#[cfg(feature = "cluster")]
pub(crate) mod publish;
mod remedy;
mod remove;
mod self_test;
mod sfm;
pub(crate) mod split;
mod view;

use crate::output::exit::Outcome;
use crate::output::ui::Ui;

/// What to do with a map.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// Build a map from images, with or without known poses.
    Build(build::BuildArgs),
    /// Build a map from a complete COLMAP model, with its points and observations.
    Import(import::ImportArgs),
    /// Print facts about a map.
    Info(info::InfoArgs),
    /// Write a page that shows a map in 3D, its weak parts, and what to do about them.
    View(view::ViewArgs),
    /// Add images with known poses to a map, without rebuilding it.
    Add(add::AddArgs),
    /// Transform a map to metres, north and gravity, or to the coordinate frame of another map.
    Align(align::AlignArgs),
    /// Merge two maps that show a common part.
    Merge(merge::MergeArgs),
    /// List, import or carry the content anchors of a map.
    Anchors(anchors::AnchorsArgs),
    /// Remove images from a map, with their keypoints and the points that only they observe.
    Remove(remove::RemoveArgs),
    /// Write the profile that a device needs to seal queries for a map; it contains no map data.
    Profile(profile::ProfileArgs),
    /// Write the pack of a map, with which a device sends only what the place knows.
    Pack(pack::PackArgs),
    /// Compress a map: a tenth of the bytes with almost no loss.
    Compress(compress::CompressArgs),
    /// Split a map into regions, for maps that exceed one machine.
    Split(split::SplitArgs),
    /// Publish the regions of a map to object storage, for services.
    #[cfg(feature = "cluster")]
    Publish(publish::PublishArgs),
    /// Publish the regions of a map (needs the cargo feature `cluster`).
    #[cfg(not(feature = "cluster"))]
    Publish(crate::commands::missing_feature::Args),
    /// Fetch and verify the regions of a published map.
    #[cfg(feature = "cluster")]
    Fetch(publish::FetchArgs),
    /// Fetch the regions of a published map (needs the cargo feature `cluster`).
    #[cfg(not(feature = "cluster"))]
    Fetch(crate::commands::missing_feature::Args),
    /// List the published versions of a map, return to an older one, or remove old ones.
    #[cfg(feature = "cluster")]
    Versions(publish::VersionsArgs),
    /// List the published versions of a map (needs the cargo feature `cluster`).
    #[cfg(not(feature = "cluster"))]
    Versions(crate::commands::missing_feature::Args),
    /// Export a map for other programs: as a COLMAP model, its points as a PLY file, or both.
    Export(export::ExportArgs),
}

pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Build(args) => build::run(args, ui),
        Command::Import(args) => import::run(args, ui),
        Command::Info(args) => info::run(args, ui),
        Command::Add(args) => add::run(args, ui),
        Command::View(args) => view::run(args, ui),
        Command::Align(args) => align::run(args, ui),
        Command::Merge(args) => merge::run(args, ui),
        Command::Anchors(args) => anchors::run(args, ui),
        Command::Remove(args) => remove::run(args, ui),
        Command::Profile(args) => profile::run(args, ui),
        Command::Pack(args) => pack::run(args, ui),
        Command::Compress(args) => compress::run(args, ui),
        Command::Split(args) => split::run(args, ui),
        #[cfg(feature = "cluster")]
        Command::Publish(args) => publish::publish(args, ui),
        #[cfg(feature = "cluster")]
        Command::Fetch(args) => publish::fetch(args, ui),
        #[cfg(feature = "cluster")]
        Command::Versions(args) => publish::versions(args, ui),
        #[cfg(not(feature = "cluster"))]
        Command::Publish(args) => crate::commands::missing_feature::run(args, "map publish", "cluster"),
        #[cfg(not(feature = "cluster"))]
        Command::Fetch(args) => crate::commands::missing_feature::run(args, "map fetch", "cluster"),
        #[cfg(not(feature = "cluster"))]
        Command::Versions(args) => crate::commands::missing_feature::run(args, "map versions", "cluster"),
        Command::Export(args) => export::run(args, ui),
    }
}
