//! `veiloc eval keypoints`: keypoints and descriptors of images, for `attack` and the training of predictors.

use std::path::PathBuf;

use veiloc_datasets::problem_files::{encode_keypoints, keypoints_of_images};
use veiloc_protocol::ExtractionLimits;

use crate::exit::{Exit, Outcome};
use crate::feature_args::ImageFeatureArgs;
use crate::files;
use crate::items::{self, IMAGES};
use crate::lists;
use crate::stages::Stages;
use crate::ui::Ui;

/// Keypoints and descriptors of images, as `attack` and the training of predictors read them.
///
/// Extracts what a device would and writes one JSON object an image, one a line, gzipped when the name ends in
/// `.gz`. The file holds keypoint positions in the clear: it is for tests of one's own images, never to be sent.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Images, JPEG or PNG, and folders: of a folder all images in it and in its sub-folders.
    #[arg(required = true, value_name = "IMAGE|FOLDER")]
    images: Vec<PathBuf>,
    /// Names of the images to use, one a line, relative to the one folder given. Cameras behind the names are not
    /// needed: keypoints are those of the image as it is.
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    /// Where the keypoints go; `-` for stdout.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Keypoints of an image at most, the strongest.
    #[arg(long, default_value_t = 2048, value_name = "N", value_parser = clap::value_parser!(u32).range(64..=65536))]
    max_keypoints: u32,
    /// Longest side, pixels; larger images are made smaller first, and positions are those of the smaller one.
    #[arg(long, default_value_t = 1600, value_name = "PX", value_parser = clap::value_parser!(u32).range(64..=8192))]
    max_size: u32,
    #[command(flatten)]
    features: ImageFeatureArgs,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let extractor = args.features.extractor()?;
    let items = match &args.list {
        None => items::gather_all(&args.images, &IMAGES)?,
        Some(list) => {
            let folder = lists::one_folder(&args.images)?;
            let listed = lists::read_with_cameras(list)?;
            let items = items::listed(folder, listed.iter().map(|l| l.name.as_str()));
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
    ui.say(format!("{}: {} images, {keypoints} keypoints", args.out.display(), images.len()));
    Ok(Exit::Success)
}
