//! `veiloc map merge`: joins two maps of one place.

use std::path::PathBuf;

use veiloc_map::{MapFile, read_anchors};
use veiloc_mapping::{MapWarning, align, merge};
use veiloc_protocol::ContentAnchors;

use super::alignment::AlignmentInfo;
use super::edit::{MapEdit, other_frame};
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
/// Content anchors of the second map join those of the first, moved by the same transform; their names must differ.
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
    let others = read_anchors(&args.other)?;
    if !others.is_of_frame(other.frame_images()) {
        return Err(other_frame(&args.other));
    }
    // Before minutes of work: names that both maps have, or too many.
    join(&mut read_anchors(&args.map)?, &others)?;
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
    let similarity = report.coordinate_frame.map_from_given;
    edit.write_with(&model, |anchors| {
        // Again: a service may have written some meanwhile.
        let mut others = read_anchors(&args.other)?;
        align::carry_anchors(&mut others, &similarity)?;
        join(anchors, &others)
    })?;
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

/// Adds the content anchors of the second map.
fn join(anchors: &mut ContentAnchors, others: &ContentAnchors) -> Result<(), Failure> {
    anchors.extend(others.anchors()).map_err(|error| {
        Failure::with_help(
            format!("content anchors of both maps: {error}"),
            "list them with `veiloc map anchors MAP --json`, and write them changed with --import",
        )
    })
}
