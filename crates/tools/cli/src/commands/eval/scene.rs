//! `veiloc eval scene`: runs the whole pipeline on a scene with known poses.

use std::path::{Path, PathBuf};

use veiloc_evaluation::pipeline::QueryTransmission;
use veiloc_evaluation::{NegativeQueryImages, SceneEvaluation, evaluate_scene};
use veiloc_map::regions::SplitOptions;
use veiloc_report::LengthUnit;

use crate::commands::eval::html::{self, HtmlArgs};
use crate::commands::eval::posed_scene::{GravityArgs, PosedSceneArgs, with_remedy};
use crate::commands::eval::report::ReportArgs;
use crate::commands::posed::read_posed;
use crate::exit::{Failure, Outcome};
use crate::extraction_args::ExtractionArgs;
use crate::lists;
use crate::localization_args::EstimatorArgs;
use crate::progressive_args::ProgressiveArgs;
use crate::stages::Stages;
use crate::targets::{OutFile, OutFolder};
use crate::ui::Ui;

/// Run the whole pipeline on a scene with known poses.
///
/// Builds a map from the images of the map list, seals every image of the query list under every scheme, localizes it,
/// and compares with its known pose. A query without a pose counts as infinite error.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    gravity: GravityArgs,
    #[command(flatten)]
    negatives: NegativeArgs,
    #[command(flatten)]
    progressive: ProgressiveArgs,
    /// Folder of the queries' masks, one per query: `door/3.jpg.png` for `door/3.jpg`, as in COLMAP. Black pixels are
    /// hidden, as with `seal --masks`.
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// Folder for intermediate results: features and matches of map images, the map, and the result of each finished
    /// query. An interrupted run continues from there, and results for the same images and options are not computed
    /// again. Default: nothing is stored.
    #[arg(long, value_name = "DIR")]
    work: Option<OutFolder>,
    /// Queries that are localized in parallel; with more than one, times are those of a loaded machine.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    jobs: u16,
    /// Localize in a map that is this many times smaller, made by `veiloc map compress --ratio`. Default: in the map as
    /// it is built.
    #[arg(long, value_name = "TIMES", value_parser = above_one)]
    compress: Option<f64>,
    /// Split the map into regions of at most N images, as `veiloc map split --images` does, and localize each query in
    /// up to three regions that hold the images which the whole map would retrieve, as `veiloc serve --cluster` does.
    /// Default: the map is not split.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    regions: Option<u32>,
    /// Share of a region's images that is reserved for images of other regions, as in `veiloc map split`. Default: 0.3.
    #[arg(long, value_name = "SHARE", requires = "regions")]
    overlap: Option<f64>,
    #[command(flatten)]
    html: HtmlArgs,
}

/// A scene, its map building, and the localization of its queries: the arguments that `eval scene` and `eval rig`
/// share.
#[derive(clap::Args)]
pub(super) struct SceneArgs {
    #[command(flatten)]
    posed_scene: PosedSceneArgs,
    /// Write the map to this file.
    #[arg(long, value_name = "FILE")]
    keep_map: Option<OutFile>,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    pub(super) report: ReportArgs,
    #[command(flatten)]
    pub(super) estimator: EstimatorArgs,
}

impl SceneArgs {
    /// Returns the evaluation without gravity and negatives.
    pub(super) fn evaluation(&self, ui: &Ui) -> Result<SceneEvaluation, Failure> {
        Ok(SceneEvaluation {
            keep_map: self.keep_map.as_deref().map(Path::to_owned),
            build: self.extraction.options()?,
            schemes: self.report.schemes.clone(),
            estimators: self.estimator.estimators()?,
            thresholds: self.report.thresholds.clone(),
            seed: self.estimator.seed,
            ..self.posed_scene.scene(true, ui)?
        })
    }
}

impl Args {
    fn regions(&self) -> Option<SplitOptions> {
        let options = SplitOptions::default().with_images(self.regions? as usize);
        Some(self.overlap.map_or(options, |overlap| options.with_overlap(overlap)))
    }
}

/// Queries that must not be localized.
#[derive(clap::Args)]
struct NegativeArgs {
    /// Posed images of another scene, of any format that `map build --posed` reads, for the cameras of the negative queries, whose poses in this map are
    /// all wrong. The table counts those that get a pose, and those that get a trusted pose.
    #[arg(id = "negatives_posed", long = "negatives-posed", value_name = "PATH", requires_all = ["negatives_images", "negatives_list"])]
    posed: Option<PathBuf>,
    /// Folder of the other scene's images.
    #[arg(
        id = "negatives_images",
        long = "negatives-images",
        value_name = "DIR",
        requires = "negatives_posed"
    )]
    images: Option<PathBuf>,
    /// Names of the negative queries, one per line.
    #[arg(id = "negatives_list", long = "negatives-list", value_name = "FILE", requires = "negatives_posed")]
    list: Option<PathBuf>,
}

impl NegativeArgs {
    fn negatives(&self, ui: &Ui) -> Result<Option<NegativeQueryImages>, Failure> {
        match (&self.posed, &self.images, &self.list) {
            (Some(posed), Some(images), Some(list)) => Ok(Some(NegativeQueryImages {
                posed: read_posed(posed, images, ui)?,
                images: images.clone(),
                list: lists::read_list(list)?,
            })),
            _ => Ok(None),
        }
    }
}

/// Parses a number above 1.
fn above_one(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(times) if times > 1.0 && times.is_finite() => Ok(times),
        _ => Err("not a finite number above 1".to_owned()),
    }
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let mut evaluation = SceneEvaluation {
        gravity: args.gravity.gravity_noise,
        negatives: args.negatives.negatives(ui)?,
        masks: args.masks.clone(),
        work: args.work.as_deref().map(Path::to_owned),
        jobs: args.jobs.into(),
        compress: args.compress,
        regions: args.regions(),
        transmission: args
            .progressive
            .stop_criterion()
            .map_or(QueryTransmission::Whole, QueryTransmission::Progressive),
        ..args.scene.evaluation(ui)?
    };
    let report = args.html.begin(1, LengthUnit::Map)?;
    if let Some(report) = &report {
        report.keep_map(&mut evaluation);
    }
    let result = evaluate_scene(&evaluation, &Stages::new(ui)).map_err(with_remedy)?;
    if let Some(map) = &result.map {
        ui.info(format!(
            "map: {} images, {} points, {:.1} MB ({:.0} bytes per point), built in {:.1} s ({:.2} s per image)",
            map.images,
            map.points,
            map.bytes as f64 / 1e6,
            map.bytes as f64 / map.points.max(1) as f64,
            map.build_seconds,
            map.build_seconds / map.images.max(1) as f64,
        ));
        if let Some(regions) = &map.regions {
            ui.info(format!(
                "regions: {}, each image in {:.2} of them, {:.1} MB (the largest {:.1} MB), and an index of {:.2} MB",
                regions.count,
                regions.images_total as f64 / map.images.max(1) as f64,
                regions.bytes as f64 / 1e6,
                regions.largest_bytes as f64 / 1e6,
                regions.index_bytes as f64 / 1e6,
            ));
        }
    }
    let exit = args.scene.report.finish(&result, ui)?;
    if let Some(mut report) = report {
        let methods = result.schemes.iter().map(|row| (None, row));
        let queries = result.queries.iter().map(|query| (None, query));
        report.add("", &evaluation, methods, queries, ui)?;
        let title = format!("Localization in {}", result.data.join(", "));
        report.write(&title, html::facts(Some(evaluation.seed)), ui)?;
    }
    Ok(exit)
}
