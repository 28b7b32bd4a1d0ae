//! `veiloc map pack`: writes the pack of a map.

use std::path::PathBuf;

use veiloc_map::MapFile;

use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::files;
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

/// Write the pack of a map: its descriptors without positions, with which a device sends only what the place knows.
///
/// It shows the textures of the place, without where they are, to everyone who gets it (docs/guide/pack.md), so the operator
/// decides. `veiloc serve --packs` serves it.
#[derive(clap::Args)]
pub(crate) struct PackArgs {
    /// The map, or a region of one.
    map: PathBuf,
    /// The pack file to write.
    #[arg(long, short, value_name = "FILE")]
    out: OutFile,
}

pub(super) fn run(args: &PackArgs, ui: &Ui) -> Outcome {
    let map = MapFile::open(&args.map)?;
    let (pack, _) = map.pack().map_err(|error| {
        Failure::with_help(
            format!("{}: {error}", args.map.display()),
            "a map needs points; of a very large map, split it with `veiloc map split` and give the packs of its regions",
        )
    })?;
    let bytes = pack.encode();
    files::write(&args.out, &bytes)?;
    ui.info(format!(
        "{}: pack {}, {} points in {} images, {} bytes",
        args.out.display(),
        pack.id(),
        pack.point_count(),
        pack.image_count(),
        bytes.len()
    ));
    Ok(Exit::Success)
}
