//! `veiloc map merge`: joins two maps of one place.

use std::path::PathBuf;

use veiloc_map::MapFile;
use veiloc_mapping::{MapWarning, merge};

use super::alignment::AlignmentInfo;
use super::edit::MapEdit;
use super::facts::InfoOutput;
use super::remedy::with_remedy;
use super::self_test::FinishArgs;
use crate::output::exit::{Failure, Outcome};
use crate::output::position::unit_of;
use crate::output::stages::Stages;
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

/// Merge two maps that show a common part: the images of the second join the first, in its coordinate frame.
///
/// Up to 50 images of each map are localized in the other. More than half of those that are localized must agree on one similarity
/// (scale, rotation, translation); it is applied to the poses of the second map, and points are triangulated again where images
/// of both see them. The features stored in the maps are used; no image is read. The profile of the first map stays.
/// Then the same is done in the other direction. If the two transforms differ by more than 2 % of the distance to the scene, or
/// too few images are localized in the other direction, the maps are not merged: the ± of poses would not include that error.
#[derive(clap::Args)]
pub(crate) struct MergeArgs {
    /// The map whose coordinate frame and profile stay.
    map: PathBuf,
    /// The map whose images join it.
    other: PathBuf,
    /// Text before the names of the second map's images, for example `day-2/`. Default: none.
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    prefix: String,
    /// Also merge maps that fit loosely, with a warning.
    #[arg(long)]
    keep_loose: bool,
    #[command(flatten)]
    finish: FinishArgs,
    /// The map file to write. Default: the first map.
    #[arg(long, short, value_name = "FILE")]
    out: Option<OutFile>,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &MergeArgs, ui: &Ui) -> Outcome {
    let edit = MapEdit::begin(&args.map, args.out.as_deref(), ui)?;
    let mut model = edit.read()?;
    let other = MapFile::open(&args.other)?.to_model();
    let mut report = merge(&mut model, &other, &args.prefix, &Stages::new(ui)).map_err(with_remedy)?;
    let loose = report.build.warnings.iter().find(|warning| matches!(warning, MapWarning::LooseMerge { .. }));
    if let Some(loose) = loose.filter(|_| !args.keep_loose) {
        return Err(Failure::with_help(
            format!("{}: {}\n{loose}", args.other.display(), report.coordinate_frame),
            "merge them nevertheless with --keep-loose",
        ));
    }
    if other.is_metric && !model.is_metric {
        ui.warn(format_args!(
            "warning: {} is in metres and {} is not, whose coordinate frame stays; give them in the other order to keep metres",
            args.other.display(),
            args.map.display()
        ));
    }
    args.finish.finish(&mut model, &mut report.build.warnings, edit.out, ui)?;
    edit.write(&model)?;
    ui.info(format_args!("{}: {}", args.other.display(), report.coordinate_frame));
    if let (Some(inverse), Some(closure)) = (&report.inverse, report.closure) {
        ui.info(format_args!(
            "Checked in the other direction: {} images localized, camera centres there and back {} {} apart in the median",
            inverse.localized,
            veiloc_report::significant(closure),
            unit_of(model.is_metric)
        ));
    }
    let output = InfoOutput {
        json: args.json,
        warnings: report.build.warnings,
        alignment: Some(AlignmentInfo::of_coordinate_frame(&report.coordinate_frame)),
        ..InfoOutput::default()
    };
    output.print(edit.out, ui)
}
