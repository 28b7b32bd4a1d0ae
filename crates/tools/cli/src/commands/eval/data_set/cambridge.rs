//! `veiloc eval cambridge`.

use veiloc_datasets::cambridge::{EXCLUDED_SCENES, read_scene, scenes};
use veiloc_geometry::Intrinsics;

use super::run::{outcome, refused};
use super::{DataSet, DataSetArgs, evaluate};
use crate::exit::Outcome;
use crate::ui::Ui;

/// Cambridge Landmarks: build a map of each scene's `dataset_train.txt` and localize its `dataset_test.txt`.
///
/// Focal lengths and distortion come from each scene's `reconstruction.nvm`. Errors are in metres and degrees.
/// `python3 -m study.paper` prints them beside the paper's.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    data_set: DataSetArgs,
    /// Scenes to evaluate. Default: all that exist, without the excluded ones.
    #[arg(long, value_delimiter = ',', value_name = "SCENE,…")]
    scenes: Vec<String>,
    /// Scenes to leave out; the default are the scenes that the paper leaves out for their many geometric outliers; an
    /// empty text leaves out none.
    #[arg(long, value_delimiter = ',', default_values_t = EXCLUDED_SCENES.map(str::to_owned), value_name = "SCENE,…")]
    exclude: Vec<String>,
    /// One camera for all images, MODEL,WIDTH,HEIGHT,PARAMS…. Default: the cameras of `reconstruction.nvm`.
    #[arg(long, value_name = "CAMERA")]
    camera: Option<Intrinsics>,
}

const DATA_SET: DataSet =
    DataSet { command: "eval cambridge", thresholds: &[(0.25, 2.0), (0.5, 5.0)], paper_max_error_px: 18.0 };

pub(in crate::commands::eval) fn run(args: &Args, ui: &Ui) -> Outcome {
    let root = &args.data_set.root;
    let names = if args.scenes.is_empty() {
        let mut names = scenes(root).map_err(refused)?;
        names.retain(|name| !args.exclude.contains(name));
        names
    } else {
        args.scenes.clone()
    };
    let read = |name: &str| read_scene(root, name, args.camera.as_ref(), args.data_set.missing());
    outcome(evaluate(&DATA_SET, &names, &read, &args.data_set, ui))
}
