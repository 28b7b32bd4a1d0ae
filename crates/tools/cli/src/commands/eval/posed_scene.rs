//! A scene with known poses, split into map and queries: the input of several evaluations.

use std::collections::BTreeMap;
use std::path::PathBuf;

use veiloc_evaluation::pipeline::GravityNoise;
use veiloc_evaluation::{EvalError, SceneEvaluation};
use veiloc_mapping::MappingError;

use crate::commands::frame_check::{FrameCheckArgs, REMEDY_OF_LOOK_ALIKES};
use crate::commands::posed::read_posed;
use crate::exit::Failure;
use crate::lists::{self, ListedImage};
use crate::ui::Ui;

/// A scene with known poses.
#[derive(clap::Args)]
pub(super) struct PosedSceneArgs {
    /// Posed images, of any format that `map build --posed` reads; points are ignored.
    #[arg(long, value_name = "PATH")]
    pub(super) posed: PathBuf,
    /// Folder of the images.
    #[arg(long, value_name = "DIR")]
    pub(super) images: PathBuf,
    /// Names of the images that the map is built from, one per line.
    #[arg(long, value_name = "FILE")]
    pub(super) map_list: PathBuf,
    /// Names of the query images, one per line. `eval scene` seals with the cameras after the names if there are any
    /// (MODEL W H PARAMS…, as in hloc's query lists), otherwise with the cameras of the model.
    #[arg(long, value_name = "FILE")]
    pub(super) query_list: PathBuf,
    #[command(flatten)]
    pub(super) check: FrameCheckArgs,
}

impl PosedSceneArgs {
    /// The scene, with default options; `with_cameras`: the query list may have cameras, which take precedence, because a
    /// device may know its lens better than the model does.
    pub(super) fn scene(&self, with_cameras: bool, ui: &Ui) -> Result<SceneEvaluation, Failure> {
        let names = |listed: &[ListedImage]| listed.iter().map(|query| query.name.clone()).collect();
        let (query_list, query_cameras) = if with_cameras {
            let listed = lists::read_with_cameras(&self.query_list)?;
            (names(&listed), listed.into_iter().filter_map(|q| Some((q.name, q.camera?))).collect())
        } else {
            (lists::read_list(&self.query_list)?, BTreeMap::new())
        };
        let posed = read_posed(&self.posed, &self.images, ui)?;
        let map_list = lists::read_list(&self.map_list)?;
        Ok(SceneEvaluation {
            query_cameras,
            on_other_frame: self.check.on_other_frame(),
            ..SceneEvaluation::of_scene(posed, self.images.clone(), map_list, query_list)
        })
    }
}

/// Adds the remedy for a refused frame to the error.
pub(super) fn with_remedy(error: EvalError) -> Failure {
    match error {
        EvalError::Mapping(MappingError::OtherFrame { .. }) => {
            Failure::with_help(error, format!("give poses in one frame; {REMEDY_OF_LOOK_ALIKES}"))
        }
        error => error.into(),
    }
}

/// The same arguments if the scene is optional: all or none of them must be given.
#[derive(clap::Args)]
pub(super) struct OptionalPosedSceneArgs {
    /// Posed images, of any format that `map build --posed` reads; points are ignored.
    #[arg(long, value_name = "PATH", requires_all = ["images", "map_list", "query_list"])]
    posed: Option<PathBuf>,
    /// Folder of the images.
    #[arg(long, value_name = "DIR", requires = "posed")]
    images: Option<PathBuf>,
    /// Names of the images that the map is built from, one per line.
    #[arg(long, value_name = "FILE", requires = "posed")]
    map_list: Option<PathBuf>,
    /// Names of the attacked images, one per line.
    #[arg(long, value_name = "FILE", requires = "posed")]
    query_list: Option<PathBuf>,
    #[command(flatten)]
    check: FrameCheckArgs,
}

impl OptionalPosedSceneArgs {
    pub(super) fn given(&self) -> Option<PosedSceneArgs> {
        Some(PosedSceneArgs {
            posed: self.posed.clone()?,
            images: self.images.clone()?,
            map_list: self.map_list.clone()?,
            query_list: self.query_list.clone()?,
            check: self.check,
        })
    }
}

/// Simulated accelerometer.
#[derive(clap::Args)]
pub(super) struct GravityArgs {
    /// Also evaluate with gravity: the map gets the direction of gravity, and every query is sealed a second time with
    /// the measurement of an accelerometer of this standard deviation at its true pose, degrees, at most 16. A second
    /// number rotates each measurement by this angle too, as of a device that accelerates or lies. Default: without
    /// gravity.
    #[arg(long = "gravity", value_name = "SD_DEG[,ERROR_DEG]")]
    pub(super) gravity_noise: Option<GravityNoise>,
}
