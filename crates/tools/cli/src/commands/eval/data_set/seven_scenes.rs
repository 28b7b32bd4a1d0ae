//! `veiloc eval 7scenes`.

use std::path::PathBuf;

use veiloc_datasets::seven_scenes::{PoseSource, read_scene, scenes};

use super::run::{outcome, refused};
use super::{DataSet, DataSetArgs, evaluate};
use crate::exit::Outcome;
use crate::ui::Ui;

/// 7Scenes: build a map of each scene's training sequences and localize its test sequences.
///
/// Reads the unpacked folders: `<scene>/TrainSplit.txt`, `<scene>/seq-01/frame-000000.color.png`. A scene's map is
/// built from all images of its training sequences; every image of its test sequences is sealed under every scheme and
/// localized. `python3 -m study.paper` prints the results beside the paper's.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    data_set: DataSetArgs,
    /// Scenes to evaluate. Default: all that exist.
    #[arg(long, value_delimiter = ',', value_name = "SCENE,…")]
    scenes: Vec<String>,
    /// Scenes to leave out. Default: none.
    #[arg(long, value_delimiter = ',', value_name = "SCENE,…")]
    exclude: Vec<String>,
    /// Ground truth: `sfm`, the pseudo ground truth from structure from motion, as in the paper; or `depth`, the poses
    /// of the depth camera that come with the images.
    #[arg(long, default_value = "sfm", value_parser = ["sfm", "depth"], value_name = "KIND")]
    poses: String,
    /// Folder of the lists of pseudo ground truth, `<scene>_train.txt` and `<scene>_test.txt`. Default: `pgt_sfm` or
    /// `pgt/sfm/7scenes` in the root.
    #[arg(long, value_name = "DIR")]
    pseudo_ground_truth: Option<PathBuf>,
}

const DATA_SET: DataSet =
    DataSet { command: "eval 7scenes", thresholds: &[(0.05, 5.0)], paper_max_error_px: 4.0 };

pub(in crate::commands::eval) fn run(args: &Args, ui: &Ui) -> Outcome {
    let root = &args.data_set.root;
    let mut names = if args.scenes.is_empty() { scenes(root).map_err(refused)? } else { args.scenes.clone() };
    names.retain(|name| !args.exclude.contains(name));
    let truth = match (args.poses.as_str(), &args.pseudo_ground_truth) {
        ("depth", _) => PoseSource::Depth,
        (_, Some(folder)) => PoseSource::Sfm(folder.clone()),
        (_, None) => PoseSource::sfm_beside(root),
    };
    let read = |name: &str| read_scene(root, name, &truth, args.data_set.missing());
    outcome(evaluate(&DATA_SET, &names, &read, &args.data_set, ui))
}
