//! `veiloc features`: extracts features of images for other programs.

use std::path::{Path, PathBuf};

use crate::args::feature_args::ImageFeatureArgs;
use rayon::prelude::*;
use veiloc_features::{Extractor, FeatureError, Limits, extract_image};
use veiloc_mapping::importers::hloc::{ImageFeatures, check_feature_names, write_features};

use crate::output::exit::{Exit, Outcome};
use crate::output::items;
use crate::output::lists;
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

/// Extract features of images for other programs, in the format of hloc's `extract_features`.
///
/// The file contains the position of every keypoint, which suffices to reconstruct the images: keep it as private as
/// the images.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Images (JPEG, PNG, WebP, HEIC), or folders with all images in them and their sub-folders.
    #[arg(required = true, value_name = "IMAGE|FOLDER")]
    images: Vec<PathBuf>,
    /// Names of the images, one per line, relative to the one given folder; cameras after the names are ignored.
    /// Default: all.
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    #[command(flatten)]
    features: ImageFeatureArgs,
    /// Maximum number of keypoints per image; the strongest are used.
    #[arg(long, default_value_t = 4096, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65536))]
    max_keypoints: u32,
    /// Images with a longer side are scaled down first, pixels; keypoints are in pixels of the file in any case.
    #[arg(long, default_value_t = 2048, value_name = "PX", value_parser = clap::value_parser!(u32).range(64..=16384))]
    max_size: u32,
    /// Output file: HDF5 with keypoints, scores, descriptors (float16, unit vectors) and image_size per image name.
    #[arg(long, value_name = "FILE.h5")]
    out_hloc: OutFile,
}

pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    let extractor = args.features.extractor()?;
    let items = match &args.list {
        None => items::expand_readable(&args.images, ui)?,
        Some(list) => {
            let listed = lists::read_with_cameras(list)?;
            let folder = lists::single_folder(&args.images)?;
            let items = items::files_of_list(folder, listed.iter().map(|l| l.name.as_str()));
            items::refuse_bad(&items)?;
            items
        }
    };
    let names = items::names(&items);
    check_feature_names(names.iter().map(String::as_str))?;
    let limits = Limits { max_keypoints: args.max_keypoints as usize, max_side: args.max_size };
    let stage = ui.stage("Extracting features", items.len() as u64);
    let all: Result<Vec<ImageFeatures>, FeatureError> = items
        .par_iter()
        .map(|item| {
            let features = extract(&item.path, extractor.as_ref(), limits);
            stage.advance(1);
            features
        })
        .collect();
    stage.finish();
    let all = all?;
    let keypoints: usize = all.iter().map(|features| features.keypoints.len()).sum();
    let images = all.len();
    write_features(&args.out_hloc, names.into_iter().zip(all))?;
    ui.info(format!("{}: {images} images, {keypoints} keypoints", args.out_hloc.display()));
    Ok(Exit::Success)
}

fn extract(path: &Path, extractor: &dyn Extractor, limits: Limits) -> Result<ImageFeatures, FeatureError> {
    let image = extract_image(path, None, extractor, limits)?;
    let size = image.size_in_file;
    Ok(ImageFeatures::of(&image.features_in_file(), size))
}
