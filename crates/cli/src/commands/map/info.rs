//! `veiloc map info`: prints facts about a map.

use std::path::PathBuf;

use super::facts::InfoOutput;
use crate::output::exit::Outcome;
use crate::output::ui::Ui;

/// Print facts about a map.
#[derive(clap::Args)]
pub(crate) struct InfoArgs {
    /// The map.
    map: PathBuf,
    /// Also list the images: name, keypoints, keypoints with a map point, camera.
    #[arg(long)]
    images: bool,
    /// Print one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &InfoArgs, ui: &Ui) -> Outcome {
    InfoOutput { list: args.images, json: args.json, ..InfoOutput::default() }.print(&args.map, ui)
}
