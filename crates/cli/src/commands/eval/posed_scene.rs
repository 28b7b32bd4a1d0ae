//! A scene with known poses, split into map and queries: the input of several evaluations.

use std::collections::BTreeMap;
use std::path::PathBuf;

use veiloc_evaluation::{EvalError, SceneEvaluation};
use veiloc_mapping::MappingError;

use crate::commands::coordinate_frame_check::{CoordinateFrameCheckArgs, REMEDY_OF_LOOK_ALIKES};
use crate::commands::posed::read_posed;
use crate::output::exit::Failure;
use crate::output::lists::{self, ListedImage};
use crate::output::ui::Ui;

/// A scene with known poses: all of it is given, or nothing.
#[derive(clap::Args)]
pub(super) struct PosedSceneArgs {
    /// Posed images, of any format that `map build --posed` reads; points are ignored.
    #[arg(long, value_name = "PATH", requires_all = ["images", "map_list", "query_list"])]
    posed: Option<PathBuf>,
    /// Folder of the images.
    #[arg(long, value_name = "DIR", requires = "posed")]
    images: Option<PathBuf>,
    /// Names of the images that the map is built from, one per line.
    #[arg(long, value_name = "FILE", requires = "posed")]
    map_list: Option<PathBuf>,
    /// Names of the query images, one per line. `eval scene` seals with the cameras after the names if there are any
    /// (MODEL W H PARAMS…, as in hloc's query lists), otherwise with the cameras of the model.
    #[arg(long, value_name = "FILE", requires = "posed")]
    query_list: Option<PathBuf>,
    #[command(flatten)]
    check: CoordinateFrameCheckArgs,
}

impl PosedSceneArgs {
    /// The scene, with default options; `None` if it is not given. `with_cameras`: the query list may have cameras,
    /// which take precedence, because a device may know its lens better than the model does.
    pub(super) fn given(&self, with_cameras: bool, ui: &Ui) -> Result<Option<SceneEvaluation>, Failure> {
        let (Some(posed), Some(images)) = (&self.posed, &self.images) else { return Ok(None) };
        let (Some(map_list), Some(query_list)) = (&self.map_list, &self.query_list) else { return Ok(None) };
        let names = |listed: &[ListedImage]| listed.iter().map(|query| query.name.clone()).collect();
        let (query_list, query_cameras) = if with_cameras {
            let listed = lists::read_with_cameras(query_list)?;
            (names(&listed), listed.into_iter().filter_map(|q| Some((q.name, q.camera?))).collect())
        } else {
            (lists::read_list(query_list)?, BTreeMap::new())
        };
        let posed = read_posed(posed, images, ui)?;
        let map_list = lists::read_list(map_list)?;
        Ok(Some(SceneEvaluation {
            query_cameras,
            on_other_coordinate_frame: self.check.on_other_coordinate_frame(),
            ..SceneEvaluation::of_scene(posed, images.clone(), map_list, query_list)
        }))
    }

    /// The same for a command that needs a scene.
    pub(super) fn scene(&self, with_cameras: bool, ui: &Ui) -> Result<SceneEvaluation, Failure> {
        self.given(with_cameras, ui)?.ok_or_else(|| {
            Failure::with_help("no scene is given", "give --posed, --images, --map-list and --query-list")
        })
    }
}

/// Adds the remedy for a refused frame to the error.
pub(super) fn with_remedy(error: EvalError) -> Failure {
    match error {
        EvalError::Mapping(MappingError::OtherCoordinateFrame { .. }) => {
            Failure::with_help(error, format!("give poses in one frame; {REMEDY_OF_LOOK_ALIKES}"))
        }
        error => error.into(),
    }
}
