//! Structure from motion of images without poses, by pycolmap or COLMAP: from a folder of images to a COLMAP model.
//!
//! Nothing of it is ours: features, matches and poses are COLMAP's; a map is then built on its poses with our features. The
//! work folder keeps the database and the models, so an interrupted run continues, and a finished one is used again.
//!
//! - [`reconstruct`]: runs it.
//! - [`SfmProgram`]: pycolmap in a Python, or the program `colmap`.
//! - [`frames_of_video`]: the frames of a video that it needs.

mod images;
mod options;
mod prepared;
mod program;
mod pycolmap;
mod state;
mod unregistered;
mod video;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use veiloc_features::Progress;
use veiloc_map::PosedImages;
use veiloc_map::colmap::read_posed;

pub use self::images::LeftOut;
pub use self::options::{MAX_EXHAUSTIVE, SfmMatching, SfmOptions};
use self::prepared::Prepared;
pub use self::program::{INSTALL, SfmProgram};
use self::state::Task;
pub use self::unregistered::{Unregistered, UnregisteredCause};
pub use self::video::{INSTALL_FFMPEG, VideoFrames, frames_of_video};
use crate::error::MappingError;
use crate::input::bad_image::{BadImage, BadImages};

/// The result of structure from motion.
#[derive(Debug)]
#[non_exhaustive]
pub struct SfmReport {
    /// The model that is used: the one with the most images.
    pub model: PathBuf,
    /// Its images with their poses.
    pub posed: PosedImages,
    /// The folder that the names of the images are relative to: the given one, or one in the work folder if there are panoramas or
    /// files of other formats than JPEG and PNG.
    pub folder: PathBuf,
    /// Number of images, of which five are of one panorama.
    pub images: usize,
    /// Number of panoramas.
    pub panoramas: usize,
    /// Images that are not in the model, with the likely cause.
    pub unregistered: Vec<Unregistered>,
    /// The other models, largest first, with their images; their frames differ.
    pub others: Vec<(PathBuf, PosedImages)>,
    /// Whether the models of an earlier run were used.
    pub is_reused: bool,
    /// The program.
    pub program: SfmProgram,
    /// How many files of the folder were left out because they are no photographs, and why.
    pub left_out: Vec<(LeftOut, usize)>,
    /// Images that cannot be decoded, and were left out.
    pub bad: Vec<BadImage>,
}

/// Computes poses of the images of a folder. `names` are the images to use, relative to the folder, or else all image
/// files in it but masks, previews and smaller copies. Images of one size, focal length and lens share a camera. Equirectangular
/// panoramas become rigs of five pinhole images. `work` keeps the database and the models between runs.
///
/// # Errors
/// [`MappingError::NoSfmProgram`]: neither pycolmap nor COLMAP was found. [`MappingError::Sfm`]: the program failed, or no
/// model could be computed. [`MappingError::EmptyList`]: there are no images. [`MappingError::BadImages`]: some cannot be decoded.
pub fn reconstruct(
    images: &Path,
    names: Option<&[String]>,
    work: &Path,
    options: &SfmOptions,
    progress: &dyn Progress,
) -> Result<SfmReport, MappingError> {
    let program = SfmProgram::find(options.python.as_deref())?;
    let (mut names, left_out) =
        names.map_or_else(|| images::all_of(images), |names| Ok((names.to_vec(), BTreeMap::new())))?;
    let bad = images::undecodable(images, &names);
    if !bad.is_empty() {
        if !options.skip_bad {
            return Err(MappingError::BadImages(BadImages { images: bad, of: names.len() }));
        }
        names.retain(|name| !bad.iter().any(|bad| bad.name == *name));
    }
    if names.is_empty() {
        return Err(MappingError::EmptyList);
    }
    let prepared = Prepared::new(images, names, work, options.are_panoramas, progress)?;
    let task = Task::new(prepared, work, options)?;
    let (reported, is_reused) = if let Some(reported) = task.finished() {
        (reported, true)
    } else {
        task.prepare()?;
        let reported = match &program {
            SfmProgram::Pycolmap { python, .. } => pycolmap::run(python, &task, progress)?,
            SfmProgram::Colmap { path } => program::run_colmap(path, &task, progress)?,
        };
        task.finish(&reported)?;
        (reported, false)
    };
    let mut models = Vec::new();
    for folder in task.models() {
        models.push((read_posed(&folder)?, folder));
    }
    // Largest first; of equally large ones the first.
    models.sort_by_key(|(posed, _)| std::cmp::Reverse(posed.images().len()));
    let mut models = models.into_iter();
    let Some((posed, model)) = models.next() else {
        return Err(MappingError::Sfm {
            reason: format!(
                "no model could be computed from {} images; check that they overlap, from different positions, and show \
                 texture",
                task.images.names.len()
            ),
        });
    };
    let others: Vec<(PosedImages, PathBuf)> = models.collect();
    let is_elsewhere = |name: &str| others.iter().any(|(posed, _)| posed.get(name).is_some());
    let unregistered: Vec<Unregistered> = task
        .images
        .names
        .iter()
        .filter(|name| posed.get(name).is_none())
        .map(|name| {
            let cause = if is_elsewhere(name) {
                UnregisteredCause::OtherModel
            } else {
                reported.get(name).copied().unwrap_or(UnregisteredCause::Unknown)
            };
            Unregistered { name: task.images.original(name).to_owned(), cause }
        })
        .collect();
    Ok(SfmReport {
        unregistered,
        folder: task.images.folder.clone(),
        images: task.images.names.len(),
        panoramas: task.images.panoramas,
        others: others
            .into_iter()
            .map(|(posed, folder)| Ok((folder, task.images.with_original_names(posed)?)))
            .collect::<Result<_, MappingError>>()?,
        posed: task.images.with_original_names(posed)?,
        model,
        is_reused,
        program,
        left_out: left_out.into_iter().collect(),
        bad,
    })
}
