//! `veiloc eval layouts`: pose accuracy and privacy of dcl layouts.

use std::path::PathBuf;

use veiloc_evaluation::privacy::layouts::{LayoutsEvaluation, evaluate_layouts, layouts_table};
use veiloc_evaluation::stress::StressCondition;
use veiloc_protocol::{DclLayout, Scheme};
use veiloc_report::plots;

use crate::commands::eval::posed_scene::{PosedSceneArgs, with_remedy};
use crate::commands::posed::read_posed;
use crate::exit::{Exit, Outcome};
use crate::extraction_args::ExtractionArgs;
use crate::files;
use crate::json_args::JsonArgs;
use crate::lists;
use crate::localization_args::{MatchArgs, PoseArgs};
use crate::stages::Stages;
use crate::targets::OutFile;
use crate::ui::Ui;

/// Compare layouts of dcl: pose accuracy relative to points, and what attackers recover under each.
///
/// Builds a map from the images of the map list, localizes every image of the query list as points and under every
/// layout, and attacks some of the same queries. The result of an adversary is its gain over the prior-only baseline in
/// bits per keypoint.
#[derive(clap::Args)]
#[command(after_long_help = ADVERSARIES)]
pub(crate) struct Args {
    #[command(flatten)]
    posed_scene: PosedSceneArgs,
    /// Layouts, as dcl schemes, in the order of the table. Layouts are compared with `dcl:paper` if it is among them.
    /// Default: the paper's, a diagonal with two corners, stripes, and layouts found by search.
    #[arg(long, value_delimiter = ',', value_parser = layout, value_name = "LAYOUT,…")]
    layouts: Vec<DclLayout>,
    /// Stress conditions of the localized queries, in addition to the unchanged images; see `eval stress`.
    #[arg(long, value_delimiter = ',', default_value = "half-hidden,sparse-map", value_name = "STRESS,…")]
    stress: Vec<StressCondition>,
    /// Keypoints to train the neighbour predictor on, as written by `eval keypoints`; attacked images among them are
    /// left out. Default: the images of the map.
    #[arg(long, value_name = "FILE")]
    train: Vec<PathBuf>,
    /// Description (.toml) of a network that also predicts neighbours, as exported by research/train.
    #[arg(long, value_name = "FILE")]
    network: Option<PathBuf>,
    /// Descriptions (.toml) of position networks, at most one per layout, for `outsider-network`.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    positions: Vec<PathBuf>,
    /// Attack only N queries, evenly spaced; poses and the prior-only baseline use all queries.
    #[arg(long, default_value_t = 4, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    max_attacked: u32,
    /// Neighbours per keypoint.
    #[arg(short, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1000))]
    k: u32,
    /// Number of seeds for pose estimation, from `--seed` upwards; a map is built for each.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Plot the adversaries' gain over the pose error into FILE, as SVG.
    #[arg(long, value_name = "FILE")]
    plot: Option<OutFile>,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    json: JsonArgs,
    #[command(flatten)]
    pose: PoseArgs,
    #[command(flatten)]
    matching: MatchArgs,
}

const ADVERSARIES: &str = "\
Form of a layout: dcl:axis=DEG:sectors=N[:shift=S][:across=DEG/N/S]:anchors=X/Y+X/Y…, anchors in image heights right
of and below the image's centre, or @DEG at infinity in that direction; two to four anchors.

Adversaries; the best attack of each counts (see `attack`):
  outsider-statistic  has the query, and predicts neighbours from descriptors, learned on other scenes
  outsider-neighbours the same with the network of --network
  outsider-network    has the query, and the network of --positions
  map-server          has the images of the map
  pose-server         a server that has estimated the pose; only keypoints without a map point are counted
  pose-server-private the same, counted on a tenth of the keypoints that hides the map, as a person does
  pose-server-images  as pose-server, with the keypoints of all map images
  several-frames      a server that has estimated the poses of two or eight queries
  several-seals       has eight sealed queries of one image
  true-neighbours     has the true neighbours, which no real attacker has; for comparison only";

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let queries = lists::read_with_cameras(&args.posed_scene.query_list)?;
    let mut evaluation = LayoutsEvaluation::new(
        read_posed(&args.posed_scene.posed, &args.posed_scene.images, ui)?,
        args.posed_scene.images.clone(),
        lists::read_list(&args.posed_scene.map_list)?,
        queries.iter().map(|q| q.name.clone()).collect(),
    );
    let stress = &mut evaluation.stress;
    stress.query_cameras = queries.into_iter().filter_map(|q| Some((q.name, q.camera?))).collect();
    stress.build = args.extraction.options()?;
    stress.on_other_frame = args.posed_scene.check.on_other_frame();
    stress.stresses.clone_from(&args.stress);
    stress.localize = args.matching.options(&args.pose);
    stress.seed = args.pose.run.seed;
    if !args.layouts.is_empty() {
        evaluation.layouts.clone_from(&args.layouts);
    }
    evaluation.train.clone_from(&args.train);
    evaluation.network.clone_from(&args.network);
    evaluation.positions.clone_from(&args.positions);
    evaluation.attacked = Some(args.max_attacked as usize);
    evaluation.k = args.k as usize;
    evaluation.seeds = args.seeds;
    let document = evaluate_layouts(&evaluation, &Stages::new(ui)).map_err(with_remedy)?;
    args.json.print(&layouts_table(&document), &document, ui)?;
    if let Some(path) = &args.plot {
        files::write(path, plots::layouts(&document)?.as_bytes())?;
    }
    let localized =
        document.rows.iter().any(|row| row.conditions.iter().any(|c| c.median_translation.is_some()));
    Ok(if localized { Exit::Success } else { Exit::Refused })
}

/// Parses a dcl layout from the text of its scheme.
fn layout(text: &str) -> Result<DclLayout, String> {
    match text.parse() {
        Ok(Scheme::Dcl(layout)) => Ok(layout),
        Ok(other) => Err(format!("{other} has no layout: give dcl schemes")),
        Err(error) => Err(error.to_string()),
    }
}
