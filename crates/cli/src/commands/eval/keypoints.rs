//! `veiloc eval keypoints`: keypoints and descriptors of images, for `attack` and the training of predictors.

use std::path::PathBuf;

use veiloc_datasets::{encode_keypoints, images_in, keypoints_of_images};
use veiloc_query::ExtractionLimits;

use crate::exit::{Exit, Failure, Outcome};
use crate::files;
use crate::ui::{Bars, Ui};

/// Keypoints and descriptors of images, as `attack` and the training of predictors read them.
///
/// Extracts what a device would and writes one JSON object an image, one a line, gzipped when the name ends in
/// `.gz`. The file holds keypoint positions in the clear: it is for tests of one's own images, never to be sent.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Images, JPEG or PNG, and folders: of a folder the images right in it.
    #[arg(required = true, value_name = "IMAGE|FOLDER")]
    images: Vec<PathBuf>,
    /// Names of the images to use, one a line, relative to the one folder given.
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    /// Where the keypoints go.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Keypoints of an image at most, the strongest.
    #[arg(long, default_value_t = 2048, value_name = "N", value_parser = clap::value_parser!(u32).range(64..=65536))]
    max_keypoints: u32,
    /// Longest side, pixels; larger images are made smaller first, and positions are those of the smaller one.
    #[arg(long, default_value_t = 1600, value_name = "PX", value_parser = clap::value_parser!(u32).range(64..=8192))]
    max_size: u32,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let images = match (&args.list, args.images.as_slice()) {
        (None, images) => images_in(images)?,
        (Some(list), [folder]) => files::read_list(list)?.iter().map(|name| folder.join(name)).collect(),
        (Some(_), _) => {
            return Err(Failure::with_help(
                "--list goes with one folder, and several places are given",
                "give the folder that the names of the list are relative to, and no more",
            ));
        }
    };
    let limits = ExtractionLimits { max_keypoints: args.max_keypoints, max_image_side: args.max_size };
    let images = keypoints_of_images(&images, limits, &Bars::new(ui))?;
    let gzip = args.out.extension().is_some_and(|e| e == "gz");
    files::write(&args.out, &encode_keypoints(&images, gzip)?)?;
    let keypoints: usize = images.iter().map(|p| p.keypoints.len()).sum();
    ui.say(format!("{}: {} images, {keypoints} keypoints", args.out.display(), images.len()));
    Ok(Exit::Success)
}
