//! `veiloc eval scene`: runs the whole pipeline on a scene with known poses.

use std::path::{Path, PathBuf};

use veiloc_evaluation::pipeline::QueryTransmission;
use veiloc_evaluation::results::{MapSummary, QueryResult, SchemeSummary};
use veiloc_evaluation::{Condition, FROM_TRUTH, Odometry, SceneEvaluation, evaluate_scene};
use veiloc_map::PosedImages;
use veiloc_map::regions::SplitOptions;
use veiloc_protocol::{DclLayout, Scheme};
use veiloc_report::LengthUnit;

use crate::args::extraction_args::ExtractionArgs;
use crate::args::localization_args::{EstimatorArgs, not_negative, positive};
use crate::args::progressive_args::ProgressiveArgs;
use crate::commands::eval::html::{self, HtmlArgs};
use crate::commands::eval::negatives::NegativeArgs;
use crate::commands::eval::pairs::PairsArgs;
use crate::commands::eval::posed_scene::{PosedSceneArgs, with_remedy};
use crate::commands::eval::report::ReportArgs;
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::stages::Stages;
use crate::output::targets::{OutFile, OutFolder};
use crate::output::ui::Ui;

/// Run the whole pipeline on a scene with known poses.
///
/// Builds a map from the images of the map list, seals every image of the query list under every condition and scheme,
/// localizes it, and compares with its known pose. A query without a pose counts as infinite error.
#[derive(clap::Args)]
#[command(after_long_help = CONDITIONS)]
pub(crate) struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Conditions of the queries, see below: `none`, or parts joined by `+`, such as half-hidden+frames:4.
    #[arg(long, value_delimiter = ',', default_value = "none", value_name = "CONDITION,…")]
    conditions: Vec<Condition>,
    /// Also start from the true pose, in rows of their own: the engine's own optimum (the result of a perfect search),
    /// and the floor (least squares on the correct matches).
    #[arg(long)]
    optimum: bool,
    /// For --optimum: a match is correct if its map point projects within this distance of the keypoint under the true
    /// pose, pixels.
    #[arg(long, default_value_t = 4.0, value_name = "PX", value_parser = positive)]
    oracle_radius: f64,
    /// For frames:N: standard deviation of the odometry error about each axis per step, degrees.
    #[arg(long, default_value_t = Odometry::default().rotation_sd_deg, value_name = "DEG", value_parser = not_negative)]
    rotation_noise: f64,
    /// For frames:N: standard deviation of the odometry error along each axis per step, map units.
    #[arg(long, default_value_t = Odometry::default().translation_sd, value_name = "T", value_parser = not_negative)]
    translation_noise: f64,
    /// For frames:N: maximum distance between consecutive queries of one trajectory, map units.
    #[arg(long, default_value_t = Odometry::default().max_distance, value_name = "T", value_parser = not_negative)]
    max_distance: f64,
    #[command(flatten)]
    negatives: NegativeArgs,
    /// Localize out-of-map images in this map, in place of a scene; all conditions are then `negatives`.
    #[arg(long, value_name = "FILE", requires = "negatives", conflicts_with_all = ["posed", "keep_map", "compress"])]
    map: Option<PathBuf>,
    #[command(flatten)]
    pairs: PairsArgs,
    #[command(flatten)]
    progressive: ProgressiveArgs,
    /// Folder of the queries' masks, one per query: `door/3.jpg.png` for `door/3.jpg`, as in COLMAP. Black pixels are
    /// hidden, as with `seal --masks`.
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// Folder for intermediate results: features and matches of map images, the map, and the result of each finished
    /// query. An interrupted run continues from there, and results for the same images and options are not computed
    /// again; those of frames:N are. Default: nothing is stored.
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
    /// up to three regions that hold the images which the whole map would retrieve, as a gateway does.
    /// Default: the map is not split.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    regions: Option<u32>,
    /// Share of a region's images that is reserved for images of other regions, as in `veiloc map split`. Default: 0.3.
    #[arg(long, value_name = "SHARE", requires = "regions")]
    overlap: Option<f64>,
    #[command(flatten)]
    html: HtmlArgs,
}

/// A scene, its map building, and the localization of its queries: the arguments that `eval scene` and `eval sessions`
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
    /// Returns the evaluation of the queries as they are.
    pub(super) fn evaluation(&self, ui: &Ui) -> Result<SceneEvaluation, Failure> {
        self.of(self.posed_scene.scene(true, ui)?)
    }

    /// Returns the evaluation of this scene.
    fn of(&self, scene: SceneEvaluation) -> Result<SceneEvaluation, Failure> {
        if self.report.schemes.contains(&Scheme::Dcl(DclLayout::Random)) {
            return Err(Failure::with_help(
                "dcl:random is for tables of attacks: no device seals with it",
                "give it to `attack`, `eval inversion` or `eval pose`",
            ));
        }
        Ok(SceneEvaluation {
            keep_map: self.keep_map.as_deref().map(Path::to_owned),
            build: self.extraction.options()?,
            schemes: self.report.schemes.clone(),
            estimators: self.estimator.estimators()?,
            thresholds: self.report.thresholds.clone(),
            seed: self.estimator.seed,
            ..scene
        })
    }
}

impl Args {
    fn regions(&self) -> Option<SplitOptions> {
        let options = SplitOptions::default().with_images(self.regions? as usize);
        Some(self.overlap.map_or(options, |overlap| options.with_overlap(overlap)))
    }
}

const CONDITIONS: &str = "\
Parts of conditions (images are changed in gray before feature extraction and rounded to 8 bits again; random choices
depend on --seed, the name of the image and the name of the part):
  dark            an eighth of the light: white is 500 instead of 4000 electrons, shot and readout noise (3 electrons)
  motion          motion blur over 13/640 of the longer side, in a random direction
  half-hidden     flat gray over one half, cut through the middle in a random direction
  side-hidden     flat gray over exactly the left or the right half, which may leave dcl only one of its two anchors
  low-resolution  reduced to 160 pixels along the longer side, enlarged to the old size
  sparse-map      a map of every tenth image of the map list, or more if fewer than four would remain
  few-keypoints   the device sends 256 rows, the smallest size class
  camera:ERROR    the device assumes a wrong camera, and declares it calibrated: f+3%, fx-3%, fy+3% (focal lengths), f~3%
                  (3 percent too long or too short at random), cx+5%, cy-5% (principal point, of the width or height),
                  k1-0.2 (first radial term); percentages up to 50
  gravity:SD      each query has the gravity of an accelerometer of this standard deviation at its true pose, degrees, at
                  most 16; gravity:SD/ERROR rotates each measurement by ERROR degrees too, as of a device that
                  accelerates or lies
  frames:N        each query is localized together with the N-1 queries before it in the list, with the true relative
                  poses and noise at every step; errors are those of its own pose. All frames:N have the same queries
  pack:explained  the device has the pack of the map, and sends only rows that it explains
  pack:matches    the device matches with the pack, and sends points without descriptors
  negatives       the images of --negatives in place of the queries; with gravity:SD their gravity is random";

/// Parses a number above 1.
fn above_one(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(times) if times > 1.0 && times.is_finite() => Ok(times),
        _ => Err("not a finite number above 1".to_owned()),
    }
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let scene = match &args.map {
        Some(_) => SceneEvaluation::of_scene(PosedImages::default(), PathBuf::new(), Vec::new(), Vec::new()),
        None => args.scene.posed_scene.scene(true, ui)?,
    };
    let own_images = Some(scene.images.as_path()).filter(|_| args.map.is_none());
    let mut evaluation = SceneEvaluation {
        negatives: args.negatives.images(own_images, ui)?,
        ..args.scene.of(scene.clone())?
    };
    evaluation = SceneEvaluation {
        conditions: args.conditions.clone(),
        from_truth: args.optimum.then_some(args.oracle_radius),
        odometry: Odometry {
            rotation_sd_deg: args.rotation_noise,
            translation_sd: args.translation_noise,
            max_distance: args.max_distance,
        },
        map: args.map.clone(),
        masks: args.masks.clone(),
        retrieved: args.pairs.retrieved()?,
        work: args.work.as_deref().map(Path::to_owned),
        jobs: args.jobs.into(),
        compress: args.compress,
        regions: args.regions(),
        transmission: args
            .progressive
            .stop_criterion()
            .map_or(QueryTransmission::Whole, QueryTransmission::Progressive),
        ..evaluation
    };
    if let Some(retrieved) = &evaluation.retrieved {
        let queries = evaluation.query_list.iter().map(String::as_str);
        args.pairs.check(retrieved, queries, &evaluation.map_list, ui)?;
    }
    let report = args.html.begin(1, LengthUnit::Map)?;
    if let Some(report) = &report {
        if !args.conditions.contains(&Condition::NONE) {
            return Err(Failure::with_help(
                "--report draws queries as they are",
                "add `none` to --conditions",
            ));
        }
        report.keep_map(&mut evaluation);
    }
    let result = evaluate_scene(&evaluation, &Stages::new(ui)).map_err(with_remedy)?;
    if let Some(map) = result.map.as_ref().filter(|_| args.map.is_none()) {
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
    if let Some(sparse) = &result.sparse_map {
        let MapSummary { images, points, .. } = sparse.map;
        ui.info(format!("sparse map: one image in {}, {images} images, {points} points", sparse.stride));
    }
    let mut exit = args.scene.report.finish(&result, ui)?;
    if args.conditions.iter().all(|condition| condition.negatives) {
        exit = Exit::Success;
    }
    if let Some(mut report) = report {
        let searches =
            |recipe: &Option<String>| recipe.as_ref().is_none_or(|of| !FROM_TRUTH.contains(&of.as_str()));
        let is_plain = |row: &&SchemeSummary| row.condition.is_none() && searches(&row.variant.recipe);
        let methods = result.schemes.iter().filter(is_plain);
        let plain = |query: &&QueryResult| query.condition.is_none() && searches(&query.variant.recipe);
        let queries = result.queries.iter().filter(plain);
        report.add("", &evaluation, methods, queries, ui)?;
        let title = format!("Localization in {}", result.data.join(", "));
        report.write(&title, html::facts(Some(evaluation.seed)), ui)?;
    }
    Ok(exit)
}
