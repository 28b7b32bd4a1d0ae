//! `veiloc eval negatives`: queries with out-of-map images, which must not get a trusted pose.

use std::path::PathBuf;

use serde::Serialize;
use veiloc_evaluation::negatives::{
    NegativeImage, NegativesEvaluation, NegativesResult, evaluate_negatives, table,
};
use veiloc_geometry::Intrinsics;
use veiloc_map::MapFile;
use veiloc_protocol::{FocalKnowledge, Scheme};

use crate::camera::{CameraArg, CameraSource};
use crate::commands::eval::split::Split;
use crate::exit::{Failure, Outcome};
use crate::extraction_error::extraction_error;
use crate::feature_args::MapFeatureArgs;
use crate::global_args::MapGlobalArgs;
use crate::items::{self, BatchSummary, InputError, Item, SkipArgs};
use crate::json_args::JsonArgs;
use crate::lists;
use crate::localization_args::{EstimatorArgs, positive};
use crate::stages::Stages;
use crate::ui::Ui;

/// Query a map with out-of-map images, and count those with a trusted pose.
///
/// Every image is extracted once, sealed under every scheme and localized. All poses are wrong; a trusted pose is a
/// false positive. An image with too few keypoints to be sealed is counted separately as unusable.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The map.
    #[arg(long, value_name = "FILE")]
    map: PathBuf,
    /// Folder of out-of-map images, JPEG or PNG, with its sub-folders.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    /// Names of the images to use, one per line, relative to the folder; a camera may follow each name (MODEL W H
    /// PARAMS…, as in hloc's query lists).
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    /// Use one half of the images, chosen by the file name alone: `design` to choose thresholds with, `final` for final
    /// figures only. Bit 32 of the 64-bit FNV-1a hash of the file name without folders is 0 in `design` and 1 in
    /// `final`.
    #[arg(long, value_enum, default_value_t = Split::All)]
    split: Split,
    /// The camera of all images, as in `veiloc seal`. Default: the camera in the list, then EXIF, and otherwise an
    /// assumed camera that the query marks as unknown: no distortion, a focal length of 1.2 times the longer side.
    #[arg(long, value_name = "MODEL,W,H,PARAMS…|FILE")]
    camera: Option<CameraArg>,
    /// Schemes to compare.
    #[arg(long, value_delimiter = ',', default_value = "points,random-lines,dcl", value_name = "SCHEME,…")]
    schemes: Vec<Scheme>,
    /// Seal each query with a random gravity direction of this stated standard deviation, degrees: it must not make a pose
    /// trusted. The map needs a direction of gravity (`map build --down`). Default: without gravity.
    #[arg(long, value_name = "SD_DEG", value_parser = positive)]
    random_gravity: Option<f64>,
    #[command(flatten)]
    features: MapFeatureArgs,
    #[command(flatten)]
    global: MapGlobalArgs,
    #[command(flatten)]
    skip: SkipArgs,
    #[command(flatten)]
    json: JsonArgs,
    #[command(flatten)]
    estimator: EstimatorArgs,
}

/// Queries with out-of-map images: every pose is wrong, and a trusted one is a false positive.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct NegativesDocument {
    /// 1.
    version: u32,
    /// `eval negatives`.
    command: &'static str,
    /// The map, as given.
    map: String,
    /// Images that were used (`--split`).
    split: Split,
    /// Seed of every random choice.
    seed: u64,
    /// Number of images.
    images: usize,
    /// Number of images that cannot be used; they are not counted in the fields below.
    failed: usize,
    #[serde(flatten)]
    result: NegativesResult,
    /// Images that cannot be used; may be empty.
    errors: Vec<InputErrorDocument>,
}

/// An image that cannot be used.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct InputErrorDocument {
    /// The image.
    file: String,
    #[serde(flatten)]
    fault: InputError,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let map = MapFile::open(&args.map)?;
    let given = images(args, ui)?;
    let items: Vec<Item> = given.iter().map(|(item, _)| item.clone()).collect();
    let names = items::names(&items);
    let mut tally = BatchSummary::begin("queried", &items, ui);
    let mut faults = Vec::new();
    let mut usable = Vec::new();
    for ((item, camera), name) in given.into_iter().zip(names) {
        match item.fault {
            Some(fault) => faults.push((name, fault)),
            None => usable.push(NegativeImage { name, path: item.path, camera }),
        }
    }
    let evaluation = NegativesEvaluation {
        images: usable,
        schemes: args.schemes.clone(),
        localize: args.estimator.estimator()?.localize,
        seed: args.estimator.seed,
        random_gravity_sd_deg: args.random_gravity,
        extractors: args.features.extractors(map.profile())?.sealing(),
        global: args.global.extractor(&args.features.models(), map.profile())?,
    };
    let result = if evaluation.images.is_empty() {
        NegativesResult::default()
    } else {
        evaluate_negatives(&map, &evaluation, &Stages::new(ui))?
    };
    faults.extend(result.unread.iter().map(|(name, error)| (name.clone(), extraction_error(error))));
    for (name, fault) in &faults {
        tally.failed(name, fault);
    }
    let text = table(&result);
    let document = NegativesDocument {
        version: 1,
        command: "eval negatives",
        map: args.map.display().to_string(),
        split: args.split,
        seed: args.estimator.seed,
        images: items.len(),
        failed: faults.len(),
        result,
        errors: faults.into_iter().map(|(file, fault)| InputErrorDocument { file, fault }).collect(),
    };
    args.json.print(&text, &document, ui)?;
    tally.end(items.len() - document.failed, "", args.skip, ui)
}

/// Returns the images, each with its camera if one is given.
fn images(args: &Args, ui: &Ui) -> Result<Vec<(Item, Option<Intrinsics>)>, Failure> {
    if !args.images.is_dir() {
        return Err(Failure::with_help(
            format!("{} is not a folder", args.images.display()),
            "give the folder of the out-of-map images",
        ));
    }
    let common = match args.camera.as_ref().map(|c| c.source(FocalKnowledge::Calibrated)).transpose()? {
        Some(CameraSource::Given(known)) => Some(known.intrinsics),
        Some(CameraSource::Exif | CameraSource::Assumed) | None => None,
    };
    let given: Vec<(Item, Option<Intrinsics>)> = match &args.list {
        None => items::expand_images(std::slice::from_ref(&args.images), ui)
            .into_iter()
            .map(|item| (item, common))
            .collect(),
        Some(list) => {
            let listed = lists::read_with_cameras(list)?;
            if let Some(own) = listed.iter().find(|l| common.is_some() && l.camera.is_some()) {
                return Err(Failure::with_help(
                    format!(
                        "{}: line {}: {} has its own camera, and --camera is given too",
                        list.display(),
                        own.line,
                        own.name
                    ),
                    "leave out --camera, or give a list without cameras",
                ));
            }
            let items = items::files_of_list(&args.images, listed.iter().map(|l| l.name.as_str()));
            items.into_iter().zip(listed).map(|(item, l)| (item, l.camera.or(common))).collect()
        }
    };
    let all = given.len();
    let selected: Vec<_> =
        given.into_iter().filter(|(item, _)| item.path.is_dir() || args.split.holds(&item.path)).collect();
    if selected.is_empty() {
        return Err(Failure::with_help(
            format!("none of the {all} images belongs to this half"),
            "give more images, or leave out --split",
        ));
    }
    Ok(selected)
}
