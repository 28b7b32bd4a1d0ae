//! `veiloc eval adversaries`: what each adversary recovers from the queries of every scheme.

use std::path::PathBuf;

use veiloc_evaluation::SceneEvaluation;
use veiloc_evaluation::attack_evaluation::AttackEvaluation;
use veiloc_evaluation::attack_evaluation::adversaries::{
    AdversariesEvaluation, Adversary, adversaries_table, evaluate_adversaries,
};
use veiloc_protocol::Scheme;

use crate::args::extraction_args::ExtractionArgs;
use crate::args::json_args::JsonArgs;
use crate::args::localization_args::EstimatorArgs;
use crate::commands::eval::posed_scene::{PosedSceneArgs, with_remedy};
use crate::output::exit::{Exit, Outcome};
use crate::output::stages::Stages;
use crate::output::ui::Ui;

/// Report what each adversary recovers from the queries of every scheme, with its best attack.
///
/// Adversaries differ in their knowledge beside the query. Adversaries that know the scene run if a scene is given (a
/// map is built from the images of the map list, and images of the query list are attacked); query-only adversaries run if they have
/// training data (--train). The table shows the best attack of each adversary, in pixels and in bits over the
/// prior-only baseline.
#[derive(clap::Args)]
#[command(after_long_help = ADVERSARIES)]
pub(crate) struct Args {
    #[command(flatten)]
    posed_scene: PosedSceneArgs,
    /// Folder of the queries' masks, one per query: `door/3.jpg.png` for `door/3.jpg`, as in COLMAP. Black pixels are
    /// hidden, as with `seal --masks`.
    #[arg(long, value_name = "DIR", requires = "posed")]
    masks: Option<PathBuf>,
    /// Keypoints of images without a map, as written by `eval keypoints`; may be combined with a scene.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    keypoints: Vec<PathBuf>,
    /// Schemes, in the order of the table. Default: all that hide positions.
    #[arg(long, value_delimiter = ',', value_name = "SCHEME,…")]
    schemes: Vec<Scheme>,
    /// Adversaries, in the order of the table; see below. Default: all whose inputs are given.
    #[arg(long, value_delimiter = ',', value_name = "ADVERSARY,…")]
    adversaries: Vec<Adversary>,
    /// Keypoints of other scenes that query-only adversaries train on, as written by `eval keypoints`; attacked images among them
    /// are left out.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    train: Vec<PathBuf>,
    /// Description (.toml) of a neighbour network, for `query-only-neighbours`; it must have been trained on other
    /// scenes.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Descriptions (.toml) of position networks, at most one per scheme, for `query-only-network`.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    positions: Vec<PathBuf>,
    /// Attack only N images of each scene or file, evenly spaced. Default: all.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    max_attacked: Option<u32>,
    /// Leave out attacks that take seconds per image (layouts of the neighbour graph).
    #[arg(long)]
    quick: bool,
    /// Neighbours per keypoint.
    #[arg(short, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1000))]
    k: u32,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    estimator: EstimatorArgs,
    #[command(flatten)]
    json: JsonArgs,
}

const ADVERSARIES: &str = "\
Adversaries, and their knowledge beside the query:
  query-only-statistic  descriptor statistics, learned from the keypoints of --train
  query-only-neighbours the neighbour network of --model, trained on other scenes
  query-only-network    the position networks of --positions, trained on other scenes: from all rows to positions
  map-server            images of the map, with keypoints
  pose-server           the map and the pose, estimated from the query; only keypoints without a map point are counted
  pose-server-private   the same, counted on a tenth of the keypoints that hides the map, as a person in front of it does
  pose-server-images    as pose-server, with the keypoints of the map's images
  several-frames        the poses of two or eight queries of the scene
  several-seals         eight sealed queries of one image
  true-neighbours       the true neighbours, from an oracle; no real attacker has them, for comparison only

Example: veiloc eval keypoints photos -o photos.jsonl.gz
         veiloc eval adversaries --posed posed --images images --map-list map.txt --query-list query.txt \\
             --train photos.jsonl.gz";

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let mut evaluation = AdversariesEvaluation {
        attack: AttackEvaluation {
            files: args.keypoints.clone(),
            positions: args.positions.clone(),
            k: args.k as usize,
            seed: args.estimator.seed,
            ..AttackEvaluation::default()
        },
        train: args.train.clone(),
        network: args.model.clone(),
        attacked: args.max_attacked.map(|n| n as usize),
        slow_attacks: !args.quick,
        ..AdversariesEvaluation::default()
    };
    if let Some(scene) = args.posed_scene.given(false, ui)? {
        evaluation.scene = Some(SceneEvaluation {
            build: args.extraction.options()?,
            estimators: vec![args.estimator.estimator()?],
            masks: args.masks.clone(),
            seed: args.estimator.seed,
            ..scene
        });
    }
    if !args.schemes.is_empty() {
        evaluation.attack.schemes.clone_from(&args.schemes);
    }
    if !args.adversaries.is_empty() {
        evaluation.adversaries.clone_from(&args.adversaries);
    }
    let document = evaluate_adversaries(&evaluation, &Stages::new(ui)).map_err(with_remedy)?;
    args.json.print(&adversaries_table(&document), &document, ui)?;
    Ok(Exit::Success)
}
