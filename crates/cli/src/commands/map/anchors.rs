//! `veiloc map anchors`: the content anchors beside a map.

use std::path::{Path, PathBuf};

use veiloc_map::{AnchorsEdit, MapFile, MapModel, anchors_path, read_anchors};
use veiloc_mapping::align::{
    AlignmentFault, AnchorTransform, anchors_by_images, anchors_by_localizing, carry_anchors,
};
use veiloc_protocol::ContentAnchors;
use veiloc_report::significant;

use super::alignment::AlignmentInfo;
use super::edit::other_frame;
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::files;
use crate::output::position::unit_of;
use crate::output::stages::Stages;
use crate::output::ui::Ui;

/// List the content anchors of a map, import them, or carry them to a map that replaced theirs.
///
/// Anchors are named poses with JSON content that apps write through the service (docs/guide/cloud-anchors.md), kept in
/// `place.anchors.json` beside `place.vmap`. They stay with the map through `map add`, `align`, `merge`, `remove` and `compress`. A
/// map that is built anew has another coordinate frame; then the service gives no anchors until they are carried.
#[derive(clap::Args)]
pub(crate) struct AnchorsArgs {
    /// The map.
    map: PathBuf,
    /// Replace the anchors by those of this file, as --json prints them.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["carry", "carry_from"])]
    import: Option<PathBuf>,
    /// Carry the anchors to the coordinate frame of this map, by the camera positions of images that it has in common with the map
    /// of the anchors: up to 64 are recorded with them.
    #[arg(long, conflicts_with = "carry_from")]
    carry: bool,
    /// Carry the anchors from this old map, by localizing up to 50 of its images in the new one.
    #[arg(long, value_name = "FILE")]
    carry_from: Option<PathBuf>,
    /// Carry the anchors although the fit is not to be believed.
    #[arg(long)]
    accept_fit: bool,
    /// Print the anchors as JSON, which --import reads.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &AnchorsArgs, ui: &Ui) -> Outcome {
    let anchors = if let Some(file) = &args.import {
        import(&args.map, file)?
    } else if args.carry || args.carry_from.is_some() {
        carry(args, ui)?
    } else {
        read_anchors(&args.map)?
    };
    if args.json {
        ui.json(&anchors)?;
        return Ok(Exit::Success);
    }
    if anchors.anchors().is_empty() {
        ui.info(format_args!("{}: no content anchors", args.map.display()));
    }
    let width = anchors.anchors().iter().map(|anchor| anchor.name.len()).max().unwrap_or(0);
    for anchor in anchors.anchors() {
        let [x, y, z] = anchor.map_from_anchor.t;
        let owner = anchor.owner.as_deref().unwrap_or("nobody");
        let bytes = anchor.content.to_string().len();
        ui.print(format_args!("{:width$}  {x:.3} {y:.3} {z:.3}  {owner}  {bytes} bytes\n", anchor.name));
    }
    Ok(Exit::Success)
}

fn import(map: &Path, file: &Path) -> Result<ContentAnchors, Failure> {
    let mut new = ContentAnchors::decode(&files::read(file)?)
        .map_err(|error| Failure::refused(format!("{}: {error}", file.display())))?;
    let opened = MapFile::open(map)?;
    if !new.is_of_frame(opened.frame_images()) {
        return Err(Failure::with_help(
            format!("{}: of another coordinate frame than {}", file.display(), map.display()),
            "import them beside the map that they are of, and carry them with `veiloc map anchors --carry-from`",
        ));
    }
    new.set_frame(opened.frame_images());
    write(map, new)
}

fn write(map: &Path, anchors: ContentAnchors) -> Result<ContentAnchors, Failure> {
    let mut edit = AnchorsEdit::begin(map)?;
    edit.anchors = anchors.clone();
    edit.write()?;
    Ok(anchors)
}

fn carry(args: &AnchorsArgs, ui: &Ui) -> Result<ContentAnchors, Failure> {
    let model = MapFile::open(&args.map)?.to_model();
    let own = read_anchors(&args.map)?;
    let beside_old = args.carry_from.as_ref().filter(|_| own.anchors().is_empty());
    let before = beside_old.map(|old| read_anchors(old)).transpose()?.unwrap_or(own);
    if before.anchors().is_empty() || (beside_old.is_none() && before.is_of_frame(model.frame_images())) {
        ui.info("There is nothing to carry: all anchors are of this map's coordinate frame");
        return Ok(before);
    }
    let found = if let Some(old) = &args.carry_from {
        let old_model = MapFile::open(old)?.to_model();
        if !before.is_of_frame(old_model.frame_images()) {
            return Err(other_frame(old));
        }
        anchors_by_localizing(&before, &old_model, &model, &Stages::new(ui))?
    } else {
        anchors_by_images(&before, &model).map_err(|error| {
            Failure::with_help(
                error,
                "if the old map still exists, localize its images with --carry-from OLD",
            )
        })?
    };
    judge(args, &found, &before, &model, ui)?;
    let mut anchors = before.clone();
    carry_anchors(&mut anchors, &found.map_from_anchors)?;
    anchors.set_frame(model.frame_images());
    // A service refuses changes while the frames differ; another program may have carried them meanwhile.
    if beside_old.is_none() && read_anchors(&args.map)? != before {
        return Err(Failure::refused(format!(
            "{}: changed meanwhile; try again",
            anchors_path(&args.map).display()
        )));
    }
    write(&args.map, anchors)
}

/// Prints the fit and the ± of each anchor; refuses a fit that is not to be believed.
fn judge(
    args: &AnchorsArgs,
    found: &AnchorTransform,
    anchors: &ContentAnchors,
    model: &MapModel,
    ui: &Ui,
) -> Result<(), Failure> {
    let unit = unit_of(model.is_metric);
    AlignmentInfo::of(&found.map_from_anchors).with_accuracy(Some(found.accuracy)).print_fit(unit, ui);
    ui.info(format_args!("  {} images agree", found.images));
    for anchor in anchors.anchors() {
        let sd = significant(found.position_sd(anchor.map_from_anchor.t));
        ui.info(format_args!("  {:>10}  {}", format!("± {sd}"), anchor.name));
    }
    let faults: Vec<String> = found.faults.iter().map(AlignmentFault::to_string).collect();
    if faults.is_empty() || args.accept_fit {
        for fault in &faults {
            ui.warn(format_args!("warning: {fault}"));
        }
        return Ok(());
    }
    Err(Failure::with_help(
        format!("{}: not carried: the fit is not to be believed: {}", args.map.display(), faults.join("; ")),
        "give a map that shows more of the same place, or carry them all the same with --accept-fit",
    ))
}
