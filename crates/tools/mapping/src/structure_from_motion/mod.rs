//! Structure from motion of images without poses, by pycolmap or COLMAP: from a folder of images to a COLMAP model.
//!
//! Nothing of it is ours: features, matches and poses are COLMAP's; a map is then built on its poses with our features. The
//! work folder keeps the database and the models, so an interrupted run continues, and a finished one is used again.
//!
//! - [`reconstruct`]: runs it.
//! - [`SfmProgram`]: pycolmap in a Python, or the program `colmap`.
//! - [`frames_of_video`]: the frames of a video that it needs.

mod images;
mod program;
mod pycolmap;
mod state;
mod video;

use std::fmt;
use std::path::{Path, PathBuf};

use veiloc_features::Progress;
use veiloc_map::PosedImages;
use veiloc_map::colmap::read_posed;

pub use self::program::{INSTALL, SfmProgram};
use self::state::Task;
pub use self::video::{INSTALL_FFMPEG, VideoFrames, frames_of_video};
use crate::error::MappingError;

/// Images up to which all pairs are matched.
pub const MAX_EXHAUSTIVE: usize = 300;

/// Which pairs of images are matched.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum SfmMatching {
    /// All pairs of up to [`MAX_EXHAUSTIVE`] images, and of more images if their names are not numbered; otherwise
    /// as for frames of a video.
    #[default]
    Auto,
    /// All pairs.
    Exhaustive,
    /// Neighbours by name, as for frames of a video, and all pairs of some hundred frames.
    Sequential,
}

/// Options of structure from motion.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct SfmOptions {
    /// The Python with pycolmap. Default: `python3` of the PATH if it has pycolmap, or else the program `colmap` of the
    /// PATH.
    pub python: Option<PathBuf>,
    /// Which pairs are matched.
    pub matching: SfmMatching,
    /// Seed of its random choices.
    pub seed: u64,
}

/// The result of structure from motion.
#[derive(Debug)]
#[non_exhaustive]
pub struct SfmReport {
    /// The model that is used: the one with the most images.
    pub model: PathBuf,
    /// Its images with their poses.
    pub posed: PosedImages,
    /// Number of images that were given.
    pub images: usize,
    /// Images that are not in the model, with the likely cause.
    pub unregistered: Vec<Unregistered>,
    /// The other models, largest first, with their numbers of images; their frames differ.
    pub others: Vec<(PathBuf, usize)>,
    /// Whether the models of an earlier run were used.
    pub is_reused: bool,
    /// The program.
    pub program: SfmProgram,
}

/// An image without a pose.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unregistered {
    /// Its name.
    pub name: String,
    /// The likely cause.
    pub cause: UnregisteredCause,
}

impl fmt::Display for Unregistered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: no pose: {}", self.name, self.cause)
    }
}

/// Why an image has no pose, as far as known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UnregisteredCause {
    /// It has few keypoints.
    FewKeypoints(usize),
    /// No other image has verified matches with it.
    NoMatches,
    /// Some images match it, but too few for a pose.
    FewMatches {
        /// Number of images.
        images: usize,
    },
    /// It is in another model.
    OtherModel,
    /// The program does not say.
    Unknown,
}

impl fmt::Display for UnregisteredCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FewKeypoints(n) => write!(f, "{n} keypoints: blurred, dark or without texture"),
            Self::NoMatches => f.write_str("no other image matches it"),
            Self::FewMatches { images } => {
                write!(f, "{images} images match it, too few or without parallax")
            }
            Self::OtherModel => f.write_str("in another model, not connected to this one"),
            Self::Unknown => f.write_str("cause unknown"),
        }
    }
}

/// Computes poses of the images of a folder. `names` are the images to use, relative to the folder, or else all JPEG and PNG
/// files in it. `work` keeps the database and the models between runs.
///
/// # Errors
/// [`MappingError::NoSfmProgram`]: neither pycolmap nor COLMAP was found. [`MappingError::Sfm`]: the program failed, or no
/// model could be computed. [`MappingError::EmptyList`]: there are no images.
pub fn reconstruct(
    images: &Path,
    names: Option<&[String]>,
    work: &Path,
    options: &SfmOptions,
    progress: &dyn Progress,
) -> Result<SfmReport, MappingError> {
    let program = SfmProgram::find(options.python.as_deref())?;
    let names = names.map_or_else(|| images::all_of(images), |names| Ok(names.to_vec()))?;
    if names.is_empty() {
        return Err(MappingError::EmptyList);
    }
    let task = Task::new(images, names, work, options)?;
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
                task.names.len()
            ),
        });
    };
    let others: Vec<(PosedImages, PathBuf)> = models.collect();
    let is_elsewhere = |name: &str| others.iter().any(|(posed, _)| posed.get(name).is_some());
    let unregistered = task.names.iter().filter(|name| posed.get(name).is_none()).map(|name| {
        let cause = if is_elsewhere(name) {
            UnregisteredCause::OtherModel
        } else {
            reported.get(name).copied().unwrap_or(UnregisteredCause::Unknown)
        };
        Unregistered { name: name.clone(), cause }
    });
    Ok(SfmReport {
        unregistered: unregistered.collect(),
        images: task.names.len(),
        others: others.iter().map(|(posed, folder)| (folder.clone(), posed.images().len())).collect(),
        posed,
        model,
        is_reused,
        program,
    })
}
