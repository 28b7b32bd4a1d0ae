//! `veiloc map import`: builds a map from a complete COLMAP model.

use std::path::PathBuf;

use veiloc_map::PosedImages;
use veiloc_map::colmap::read_model;
use veiloc_mapping::{Input, MappingError};

use super::edit::warn_of_anchors;
use super::facts::InfoOutput;
use super::output_args::OutputArgs;
use super::posed_args::BadImageArgs;
use super::remedy::{REMEDY_OF_IMPORT, with_remedy};
use super::self_test::FinishArgs;
use crate::args::extraction_args::ExtractionArgs;
use crate::commands::coordinate_frame_check::CoordinateFrameCheckArgs;
use crate::commands::posed::warn_of;
use crate::output::exit::{Failure, Outcome};
use crate::output::stages::Stages;
use crate::output::ui::Ui;

/// Build a map from a complete COLMAP model, with its points and observations.
///
/// Descriptors are extracted from the images and assigned to the model's points by position.
#[derive(clap::Args)]
pub(crate) struct ImportArgs {
    /// Folder of the COLMAP model, text or binary.
    #[arg(long, value_name = "DIR")]
    model: PathBuf,
    /// Folder of the images.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    #[command(flatten)]
    check: CoordinateFrameCheckArgs,
    #[command(flatten)]
    bad: BadImageArgs,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    finish: FinishArgs,
    #[command(flatten)]
    written: OutputArgs,
}

pub(super) fn run(args: &ImportArgs, ui: &Ui) -> Outcome {
    let colmap = read_model(&args.model)?;
    warn_of(&args.model, colmap.remarks(), ui);
    let options = args.extraction.options()?;
    let posed = PosedImages::from(&colmap);
    let input = Input::new(&posed, &args.images)
        .on_bad_image(args.bad.on_bad_image())
        .on_other_coordinate_frame(args.check.on_other_coordinate_frame());
    let imported = veiloc_mapping::import(&colmap, &input, &options, &Stages::new(ui));
    let (mut model, mut report) = imported.map_err(|error| match error {
        MappingError::OtherCoordinateFrame { .. } => Failure::with_help(error, REMEDY_OF_IMPORT),
        error => with_remedy(error),
    })?;
    model.down = args.written.down;
    model.is_metric = args.written.metres;
    ui.info(&report);
    args.finish.finish(&mut model, &mut report.warnings, &args.written.out, ui)?;
    veiloc_map::write(&model, &args.written.out)?;
    warn_of_anchors(&args.written.out, &model, ui);
    let output = InfoOutput {
        json: args.written.json,
        coordinate_frame: report.coordinate_frame,
        skipped: report.skipped,
        warnings: report.warnings,
        ..InfoOutput::default()
    };
    output.print(&args.written.out, ui)
}
