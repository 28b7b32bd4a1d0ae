//! `veiloc eval problems`: writes correspondence sets of a scene with known poses, for `eval pose` and for fitting.

use std::path::{Path, PathBuf};

use veiloc_datasets::problem_files::json_lines;
use veiloc_datasets::problem_files::{KeypointImage, encode_keypoints};
use veiloc_evaluation::{SceneEvaluation, make_problems};

use crate::args::extraction_args::ExtractionArgs;
use crate::args::localization_args::EstimatorArgs;
use crate::commands::eval::posed_scene::{PosedSceneArgs, with_remedy};
use crate::output::exit::{Exit, Outcome};
use crate::output::files;
use crate::output::stages::Stages;
use crate::output::targets::{OutFile, OutFileOrStdout};
use crate::output::ui::Ui;

/// Write correspondence sets of a scene with known poses, for `eval pose`.
///
/// Builds a map from the images of the map list, matches every image of the query list with it, and writes the matches
/// with the true poses: one JSON object per line, gzipped if the name ends in `.gz`.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    posed_scene: PosedSceneArgs,
    /// Output file of the problems; `-` for stdout.
    #[arg(short, long, value_name = "FILE")]
    out: OutFileOrStdout,
    /// Output file for all keypoints of the queries, with descriptors, strongest first, as read by `attack` and `eval
    /// adversaries`; positions are those of the problems. They are in the clear: use it for tests with your own images.
    #[arg(long, value_name = "FILE")]
    keypoints: Option<OutFile>,
    /// Folder of the queries' masks, one per query: `door/3.jpg.png` for `door/3.jpg`, as in COLMAP. Black pixels are
    /// hidden, as with `seal --masks`.
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    estimator: EstimatorArgs,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let scene = SceneEvaluation {
        build: args.extraction.options()?,
        estimators: vec![args.estimator.estimator()?],
        masks: args.masks.clone(),
        seed: args.estimator.seed,
        ..args.posed_scene.scene(false, ui)?
    };
    let (lines, images): (Vec<String>, Vec<KeypointImage>) = make_problems(&scene, false, &Stages::new(ui))
        .map_err(with_remedy)?
        .into_iter()
        .map(|made| (made.line, made.keypoints))
        .unzip();
    let gzip = |path: &Path| path.extension().is_some_and(|e| e == "gz");
    files::write_or_print(&args.out, &json_lines::encode(&lines, gzip(&args.out))?, ui)?;
    if let Some(path) = &args.keypoints {
        files::write(path, &encode_keypoints(&images, gzip(path))?)?;
    }
    ui.info(format!("{}: {} problems", args.out.display(), lines.len()));
    Ok(Exit::Success)
}
