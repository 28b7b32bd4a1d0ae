//! `veiloc map add`: adds images with known poses to a map.

use std::path::PathBuf;

use super::coordinate_frame::CoordinateFrameArgs;
use super::edit::MapEdit;
use super::facts::InfoOutput;
use super::posed_args::PosedArgs;
use super::remedy::with_remedy;
use super::self_test::FinishArgs;
use crate::args::feature_args::MapFeatureArgs;
use crate::args::global_args::MapGlobalArgs;
use crate::output::exit::{Failure, Outcome};
use crate::output::stages::Stages;
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

/// Add images with known poses to a map, without rebuilding it.
///
/// Before they join, the images are localized in the map. If their poses are in another coordinate frame than the map, the command
/// refuses them, or transforms them with --align.
#[derive(clap::Args)]
#[command(mut_arg("posed", |posed| posed.required(true)))]
pub(crate) struct AddArgs {
    /// The map.
    map: PathBuf,
    #[command(flatten)]
    posed: PosedArgs,
    #[command(flatten)]
    features: MapFeatureArgs,
    #[command(flatten)]
    global: MapGlobalArgs,
    /// Text before the names of the images in the map, for example `session-2/`: for a session whose files have the same
    /// names as images of the map. Default: none.
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    prefix: String,
    #[command(flatten)]
    coordinate_frame: CoordinateFrameArgs,
    #[command(flatten)]
    finish: FinishArgs,
    /// The map file to write. Default: the map itself.
    #[arg(long, short, value_name = "FILE")]
    out: Option<OutFile>,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &AddArgs, ui: &Ui) -> Outcome {
    let posed_input = args.posed.read(ui, |_| Err(Failure::refused("give poses with --posed")))?;
    posed_input.check_masks(ui)?;
    let edit = MapEdit::begin(&args.map, args.out.as_deref(), ui)?;
    let mut model = edit.read()?;
    let extractors = args.features.extractors(&model.profile)?;
    let global = args.global.extractor(&args.features.models(), &model.profile)?;
    let mut input = posed_input.input().with_extractors(&extractors).with_prefix(&args.prefix);
    input = input.on_other_coordinate_frame(args.coordinate_frame.on_other_coordinate_frame());
    if let Some(global) = &global {
        input = input.with_global(global);
    }
    let mut report = veiloc_mapping::add(&mut model, &input, &Stages::new(ui)).map_err(with_remedy)?;
    args.finish.finish(&mut model, &mut report.warnings, edit.out, ui)?;
    edit.write(&model)?;
    let output = InfoOutput {
        json: args.json,
        coordinate_frame: report.coordinate_frame,
        skipped: report.skipped,
        warnings: report.warnings,
        ..InfoOutput::default()
    };
    output.print(edit.out, ui)
}
