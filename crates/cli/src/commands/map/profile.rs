//! `veiloc map profile`: writes the profile of a map.

use std::path::PathBuf;

use veiloc_map::MapFile;

use crate::output::exit::{Exit, Outcome};
use crate::output::files;
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

/// Write the profile that a device needs to seal queries for a map; it contains no map data.
#[derive(clap::Args)]
pub(crate) struct ProfileArgs {
    /// The map.
    map: PathBuf,
    /// The profile file to write.
    #[arg(long, short, value_name = "FILE")]
    out: OutFile,
}

pub(super) fn run(args: &ProfileArgs, ui: &Ui) -> Outcome {
    let map = MapFile::open(&args.map)?;
    let bytes = map.profile().encode();
    files::write(&args.out, &bytes)?;
    ui.info(format!("{}: profile {}, {} bytes", args.out.display(), map.profile().id(), bytes.len()));
    Ok(Exit::Success)
}
