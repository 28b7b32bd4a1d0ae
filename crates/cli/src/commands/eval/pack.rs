//! `veiloc eval pack`: what a place says about the rows of images.

use std::path::PathBuf;

use serde::Serialize;
use veiloc_datasets::problem_files::read_keypoints;
use veiloc_features::Progress;
use veiloc_obfuscation::{ExplainedRow, KnownPlace};

use crate::commands::device_args::read_pack;
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::files;
use crate::output::stages::Stages;
use crate::output::targets::OutFileOrStdout;
use crate::output::ui::Ui;

/// Look up the keypoints of images in the pack of a place: which of them a device with this pack sends.
///
/// Writes one JSON object per image and line: `explained`, whether a device may send each keypoint; `ratio`, of each the
/// distance to the nearest descriptor of the place over that to the nearest one of the background; and `matches`, of each
/// the point of the pack that it matches best, with the probability, or null.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Keypoints with descriptors, as written by `veiloc eval keypoints`.
    keypoints: PathBuf,
    /// The pack, as written by `veiloc map pack`.
    #[arg(long, value_name = "FILE")]
    pack: PathBuf,
    /// Output file; `-` for stdout.
    #[arg(short, long, value_name = "FILE")]
    out: OutFileOrStdout,
}

#[derive(Serialize)]
struct Line {
    name: String,
    explained: Vec<bool>,
    ratio: Vec<f32>,
    matches: Vec<Option<(u32, f64)>>,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let place = KnownPlace::new(read_pack(&args.pack)?)?;
    let images = read_keypoints(&args.keypoints)?;
    let stages = Stages::new(ui);
    stages.start("Looking up", images.len());
    let mut lines = Vec::new();
    for image in images {
        let Some(descriptors) = image.descriptors else {
            return Err(Failure::with_help(
                format!("{}: {} has no descriptors", args.keypoints.display(), image.name),
                "write the file with `veiloc eval keypoints`",
            ));
        };
        let rows = place.look_up(&descriptors)?;
        let line = Line {
            name: image.name,
            explained: rows.iter().map(ExplainedRow::is_explained).collect(),
            ratio: rows.iter().map(|row| row.ratio).collect(),
            matches: rows
                .iter()
                .map(|row| row.candidate.map(|best| (best.point, best.weight.probability())))
                .collect(),
        };
        serde_json::to_writer(&mut lines, &line).map_err(std::io::Error::from)?;
        lines.push(b'\n');
        stages.advance(1);
    }
    stages.finish();
    files::write_or_print(&args.out, &lines, ui)?;
    Ok(Exit::Success)
}
