//! `veiloc map export`: exports a map for other programs.

use std::path::PathBuf;

use veiloc_map::colmap::{check_text_folder, export, write_binary, write_text};
use veiloc_map::{MapFile, write_ply};

use crate::output::exit::{Exit, Outcome};
use crate::output::targets::{OutFile, OutFolder};
use crate::output::ui::Ui;

/// Export a map for other programs: as a COLMAP model, its points as a PLY file, or both.
///
/// The COLMAP model has the map's cameras, poses, keypoints and points with their tracks, for COLMAP, pycolmap and
/// hloc; images and points are numbered from 1 in the map's order. It has no descriptors: `veiloc map import` extracts
/// them from the images again. The PLY file has positions in map units, mean reprojection errors and numbers of images,
/// for point cloud viewers.
///
/// Both files reveal the mapped scene: protect them as you protect the map.
#[derive(clap::Args)]
pub(crate) struct ExportArgs {
    /// The map.
    map: PathBuf,
    /// Folder of the COLMAP model to write: cameras.bin, images.bin, points3D.bin, rigs.bin and frames.bin. It is
    /// created if it does not exist. No default.
    #[arg(long, value_name = "DIR", required_unless_present = "ply")]
    colmap: Option<OutFolder>,
    /// Write COLMAP's text files instead of the binary ones.
    #[arg(long, requires = "colmap")]
    text: bool,
    /// The PLY file of points to write. No default.
    #[arg(long, value_name = "FILE")]
    ply: Option<OutFile>,
}

pub(super) fn run(args: &ExportArgs, ui: &Ui) -> Outcome {
    if let Some(dir) = args.colmap.as_deref().filter(|_| args.text) {
        check_text_folder(dir)?;
    }
    let model = MapFile::open(&args.map)?.to_model();
    if let Some(dir) = &args.colmap {
        let write = if args.text { write_text } else { write_binary };
        write(&export(&model)?, dir)?;
        ui.info(format!("{}: {} images, {} points", dir.display(), model.images.len(), model.points.len()));
    }
    if let Some(path) = &args.ply {
        write_ply(&model, path)?;
        ui.info(format!("{}: {} points", path.display(), model.points.len()));
    }
    Ok(Exit::Success)
}
