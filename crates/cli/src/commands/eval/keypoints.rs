//! `veiloc eval keypoints`: extracts keypoints and descriptors of images, for `attack` and for training predictors.

use std::path::PathBuf;

use veiloc_datasets::problem_files::{encode_keypoints, keypoints_of_images};
use veiloc_protocol::ExtractionLimits;

use crate::args::feature_args::ImageFeatureArgs;
use crate::output::exit::{Exit, Outcome};
use crate::output::files;
use crate::output::items;
use crate::output::lists;
use crate::output::stages::Stages;
use crate::output::targets::OutFileOrStdout;
use crate::output::ui::Ui;

/// Extract keypoints and descriptors of images, for `attack` and for training predictors.
///
/// Extracts the features of a device and writes one JSON object per image and line, gzipped if the name ends in `.gz`.
/// The file contains keypoint positions in the clear: use it for tests with your own images and never send it.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Images (JPEG, PNG, WebP, HEIC), or folders with all images in them and their sub-folders.
    #[arg(required = true, value_name = "IMAGE|FOLDER")]
    images: Vec<PathBuf>,
    /// Names of the images to use, one per line, relative to the one given folder. Cameras after the names are ignored:
    /// keypoints are in pixels of the stored image.
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    /// Output file of the keypoints; `-` for stdout.
    #[arg(short, long, value_name = "FILE")]
    out: OutFileOrStdout,
    /// Maximum number of keypoints per image; the strongest are used.
    #[arg(long, default_value_t = 2048, value_name = "N", value_parser = clap::value_parser!(u32).range(64..=65536))]
    max_keypoints: u32,
    /// Longest side, pixels; larger images are scaled down first, and positions refer to the scaled image.
    #[arg(long, default_value_t = 1600, value_name = "PX", value_parser = clap::value_parser!(u32).range(64..=8192))]
    max_size: u32,
    #[command(flatten)]
    features: ImageFeatureArgs,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let extractor = args.features.device_extractor()?;
    let items = match &args.list {
        None => items::expand_readable(&args.images, ui)?,
        Some(list) => {
            let folder = lists::single_folder(&args.images)?;
            let listed = lists::read_with_cameras(list)?;
            let items = items::files_of_list(folder, listed.iter().map(|l| l.name.as_str()));
            items::refuse_bad(&items)?;
            items
        }
    };
    let limits = ExtractionLimits { max_keypoints: args.max_keypoints, max_image_side: args.max_size };
    let paths: Vec<PathBuf> = items.iter().map(|item| item.path.clone()).collect();
    let mut images = keypoints_of_images(&paths, extractor.as_ref(), limits, &Stages::new(ui))?;
    for (image, name) in images.iter_mut().zip(items::names(&items)) {
        image.name = name;
    }
    let gzip = args.out.extension().is_some_and(|e| e == "gz");
    files::write_or_print(&args.out, &encode_keypoints(&images, gzip)?, ui)?;
    let keypoints: usize = images.iter().map(|p| p.keypoints.len()).sum();
    ui.info(format!("{}: {} images, {keypoints} keypoints", args.out.display(), images.len()));
    Ok(Exit::Success)
}
