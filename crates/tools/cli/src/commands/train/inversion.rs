//! `veiloc train inversion`: the networks that make images of descriptors.

use std::path::PathBuf;
use std::time::Instant;

use veiloc_evaluation::EvalError;
use veiloc_evaluation::inversion::{
    Form, InversionDocument, InversionTask, Sees, Shape, inversion_table, read_examples, refuse_shared, train,
};
use veiloc_protocol::{ExtractionLimits, Scheme};
use veiloc_report::plots;

use super::course::CourseArgs;
use crate::exit::{Exit, Failure, Outcome};
use crate::feature_args::ImageFeatureArgs;
use crate::files;
use crate::items::{self, IMAGES};
use crate::json_args::JsonArgs;
use crate::stages::Stages;
use crate::ui::Ui;

/// Train the network that makes images of descriptors.
///
/// One U-Net, or three in a row as the paper uses them for SIFT: which placed descriptors to believe, a first image, a finer one.
/// Learns from the images of `--train`, whose keypoints are extracted first, and keeps the step with the highest PSNR on
/// those of `--validate`. Give images of different places, and judge the network by `eval inversion` on a third one. With
/// `--sees places` descriptors stand where their keypoints are, which is the paper's; with `--sees lines` they are spread over
/// what is sent under `--scheme`; with `--sees bag` nothing is told of places. The defaults are what two cores train in an
/// hour; the paper's network is `--width 64 --depth 5 --side 256` or more.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Images to learn from, JPEG or PNG, and folders: of a folder all images in it and in its sub-folders.
    #[arg(long, required = true, num_args = 1.., value_name = "IMAGE|FOLDER")]
    train: Vec<PathBuf>,
    /// Images of another place, by which the best step is chosen.
    #[arg(long, required = true, num_args = 1.., value_name = "IMAGE|FOLDER")]
    validate: Vec<PathBuf>,
    #[command(flatten)]
    course: CourseArgs,
    /// How the network is built.
    #[arg(long, value_enum, default_value = "unet")]
    shape: Built,
    /// What the network is given of places.
    #[arg(long, value_enum, default_value = "places")]
    sees: Given,
    /// Put up to so many percent of an image's descriptors into wrong places while it is learned from, as attacks do. Default:
    /// 60 with `--shape invsfm`, whose first stage learns which they are; 0 otherwise.
    #[arg(long, value_name = "PERCENT", value_parser = clap::value_parser!(u8).range(..=90))]
    wrong: Option<u8>,
    /// Scheme under which images are sent, for `--sees lines`, which needs one. No default.
    #[arg(long, value_name = "SCHEME")]
    scheme: Option<Scheme>,
    /// Channels of the finest level; each coarser one has twice as many. The paper's network has 64.
    #[arg(long, default_value_t = 16, value_name = "N")]
    width: u32,
    /// Levels, each of half the sides. The paper's network has 5.
    #[arg(long, default_value_t = 5, value_name = "N")]
    depth: u32,
    /// Cells of the longer side of an image.
    #[arg(long, default_value_t = 128, value_name = "N")]
    side: u32,
    /// Keypoints of an image at most, the strongest.
    #[arg(long, default_value_t = 1024, value_name = "N", value_parser = clap::value_parser!(u32).range(64..=65536))]
    max_keypoints: u32,
    #[command(flatten)]
    features: ImageFeatureArgs,
    #[command(flatten)]
    json: JsonArgs,
}

/// How the network is built.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Built {
    /// One U-Net.
    Unet,
    /// Three in a row, after InvSfM; takes places.
    Invsfm,
}

/// What the network is given of places.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Given {
    /// The place of each keypoint.
    Places,
    /// The line of each keypoint.
    Lines,
    /// Nothing.
    Bag,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let course = &args.course;
    let extractor = args.features.extractor()?;
    let sees = match args.sees {
        Given::Places => Sees::Places,
        Given::Lines => Sees::Lines,
        Given::Bag => Sees::Bag,
    };
    let form = match args.shape {
        Built::Unet => Form::UNet,
        Built::Invsfm => Form::InvSfm,
    };
    let shape = Shape {
        form,
        dimension: extractor.kind().dim(),
        width: args.width as usize,
        depth: args.depth as usize,
        side: args.side as usize,
        sees,
    };
    let task = InversionTask::new(shape, args.scheme)?;
    let task = args.wrong.map_or(Ok(task), |percent| task.with_wrong(percent))?;
    let limits = ExtractionLimits { max_keypoints: args.max_keypoints, ..ExtractionLimits::default() };
    let read = |given: &[PathBuf]| -> Result<_, Failure> {
        let items = items::gather_all(given, &IMAGES)?;
        let paths: Vec<PathBuf> = items.iter().map(|item| item.path.clone()).collect();
        Ok(read_examples(&paths, extractor.as_ref(), limits, &task, &Stages::new(ui))?)
    };
    let (training, validation) = (read(&args.train)?, read(&args.validate)?);
    refuse_shared(&training, &validation)?;
    let earlier = course.earlier(ui)?;
    let words = |judged: f64| format!("validation PSNR {judged:.3} dB");
    let began = Instant::now();
    let trained = course.watched(ui, words, |observe| {
        let trained: Result<_, EvalError> =
            train(&training, &validation, &task, &course.course(), earlier, observe);
        Ok(trained?)
    })?;
    course.write(&trained.network.encode(), &trained.state, ui)?;
    let seconds = began.elapsed().as_secs_f64();
    let document =
        InversionDocument::new(&trained, (&task, &course.course()), [&training, &validation], seconds);
    if let Some(path) = course.plot() {
        let points: Vec<[f64; 3]> = trained.curve.iter().map(|p| [p.step as f64, p.loss, p.judged]).collect();
        files::write(path, plots::course(&points, "PSNR of validation images, dB")?.as_bytes())?;
    }
    args.json.print(&inversion_table(&document), &document, ui)?;
    Ok(Exit::Success)
}
