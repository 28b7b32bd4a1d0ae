//! Writes the poses of queries for other programs.

use std::path::Path;

use veiloc_evaluation::results::pose_lines::{TumStamps, hloc_line, tum_line, tum_stamps};
use veiloc_geometry::Intrinsics;
use veiloc_map::colmap::{ColmapImage, ColmapModel, check_text_folder, write_binary, write_text};
use veiloc_protocol::PoseDocument;

use crate::output::exit::Failure;
use crate::output::files;
use crate::output::items::Item;
use crate::output::targets::{OutFile, OutFolder};
use crate::output::ui::Ui;

/// Output files of poses.
#[derive(clap::Args)]
pub(super) struct PoseFileArgs {
    /// Write the poses in hloc's result format: `name qw qx qy qz tx ty tz`, world to camera, in the order of the list,
    /// under its names; for sealed queries their paths without `.vquery`. Queries without a pose are left out. Default:
    /// not written.
    #[arg(long, value_name = "FILE")]
    out_hloc: Option<OutFile>,
    /// Write the localized images of the list as a COLMAP model without points, with the given cameras. Default: not
    /// written.
    #[arg(long, value_name = "DIR", requires = "list")]
    out_colmap: Option<OutFolder>,
    /// Write COLMAP's text files instead of the binary ones.
    #[arg(long, requires = "out_colmap")]
    text: bool,
    /// Write the poses as a TUM trajectory: `time tx ty tz qx qy qz qw`, camera to world. The time, in seconds, is the
    /// number in each file name if all names are seconds with a decimal point, microseconds (16 digits) or nanoseconds
    /// (17 to 19 digits), otherwise the index in the list. Default: not written.
    #[arg(long, value_name = "FILE")]
    out_tum: Option<OutFile>,
}

/// Result of a query.
pub(super) struct QueryPose {
    pub(super) name: String,
    pub(super) pose: Option<PoseDocument>,
    /// The original camera, if the image was sealed here.
    pub(super) camera: Option<Intrinsics>,
}

/// Returns the name of a query in pose files: the name of its image, if known.
pub(super) fn name_of(item: &Item, is_image: bool) -> String {
    let name = item.name();
    if is_image { name } else { name.strip_suffix(".vquery").unwrap_or(name) }.to_owned()
}

impl PoseFileArgs {
    /// Refuses names that pose files cannot hold, and a folder that cannot take a text model, before the computation.
    ///
    /// # Errors
    /// A name contains white space, or the folder has a binary model.
    pub(super) fn check(&self, items: &[Item], are_images: bool) -> Result<(), Failure> {
        if let Some(dir) = self.out_colmap.as_deref().filter(|_| self.text) {
            check_text_folder(dir)?;
        }
        let called = items.iter().map(|item| name_of(item, are_images));
        for name in called.filter(|_| self.out_hloc.is_some()) {
            if name.contains(char::is_whitespace) {
                return Err(Failure::with_help(
                    format!("{name:?} has white space, which separates the fields of a result file"),
                    "leave it out of the list, or give the image another name",
                ));
            }
        }
        Ok(())
    }

    /// Writes the requested files.
    ///
    /// # Errors
    /// A file cannot be written.
    pub(super) fn write(&self, answered: &[QueryPose], ui: &Ui) -> Result<(), Failure> {
        let posed = || answered.iter().filter_map(|query| Some((query, query.pose?)));
        if let Some(path) = &self.out_hloc {
            let lines = posed().filter_map(|(query, pose)| Some(hloc_line(&query.name, &pose)? + "\n"));
            save(path, &lines.collect::<String>(), answered.len(), ui)?;
        }
        if let Some(path) = &self.out_tum {
            let TumStamps { stamps, source } = tum_stamps(answered.iter().map(|query| query.name.as_str()));
            let lines = answered
                .iter()
                .zip(stamps)
                .filter_map(|(query, stamp)| Some(tum_line(&stamp, &query.pose?.pose()?) + "\n"));
            save(path, &lines.collect::<String>(), answered.len(), ui)?;
            ui.info(format!("{}: {source}", path.display()));
        }
        if let Some(dir) = &self.out_colmap {
            let model = colmap_model(posed())?;
            let write = if self.text { write_text } else { write_binary };
            write(&model, dir)?;
            ui.info(format!("{}: {} images", dir.display(), model.images().len()));
        }
        Ok(())
    }
}

fn save(path: &Path, lines: &str, queries: usize, ui: &Ui) -> Result<(), Failure> {
    files::write(path, lines.as_bytes())?;
    ui.info(format!("{}: poses of {} of {queries} queries", path.display(), lines.lines().count()));
    Ok(())
}

/// Builds a COLMAP model of images with poses; equal cameras are shared.
fn colmap_model<'a>(
    posed: impl Iterator<Item = (&'a QueryPose, PoseDocument)>,
) -> Result<ColmapModel, Failure> {
    let mut cameras: Vec<Intrinsics> = Vec::new();
    let mut images = Vec::new();
    for (query, pose) in posed {
        let (Some(camera), Some(cam_from_world)) = (query.camera, pose.pose()) else { continue };
        let known = cameras.iter().position(|c| *c == camera);
        let index = known.unwrap_or_else(|| {
            cameras.push(camera);
            cameras.len() - 1
        });
        images.push(ColmapImage {
            id: images.len() as u32 + 1,
            name: query.name.clone(),
            camera_id: index as u32 + 1,
            cam_from_world,
            points2d: Vec::new(),
        });
    }
    Ok(ColmapModel::new((1..).zip(cameras).collect(), images, Vec::new())?)
}
