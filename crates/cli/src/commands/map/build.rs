//! `veiloc map build`: builds a map from images, with or without known poses.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use veiloc_mapping::NameIndex;
use veiloc_mapping::build_cache::FolderCache;
use veiloc_mapping::importers::hloc::{check_pair_name, read_pairs, write_pairs};

use super::coordinate_frame::CoordinateFrameArgs;
use super::edit::warn_of_anchors;
use super::facts::InfoOutput;
use super::output_args::OutputArgs;
use super::posed_args::{PosedArgs, PosedInput};
use super::remedy::with_remedy;
use super::self_test::FinishArgs;
use super::sfm::SfmArgs;
use crate::args::extraction_args::ExtractionArgs;
use crate::output::exit::{Failure, Outcome};
use crate::output::stages::Stages;
use crate::output::targets::{OutFile, OutFolder};
use crate::output::ui::Ui;

/// Build a map from images, with or without known poses.
///
/// Poses are those of --posed, or else structure from motion computes them, by pycolmap or COLMAP: the map then has no metric
/// scale, and its work folder (--work, or beside the map) keeps what it computed, so that an interrupted build continues.
///
/// Extracts features, matches overlapping images, checks the matches against the known poses, triangulates map points,
/// localizes some of the map's own images as a self-test, and writes one file. A group of images whose poses are in
/// another coordinate frame than the rest is refused, or its poses are transformed with --align. An existing map stays unchanged if the
/// build is interrupted, or if nothing can be localized in the new map.
#[derive(clap::Args)]
pub(crate) struct BuildArgs {
    #[command(flatten)]
    posed: PosedArgs,
    #[command(flatten)]
    sfm: SfmArgs,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    finish: FinishArgs,
    #[command(flatten)]
    pairs: PairArgs,
    #[command(flatten)]
    coordinate_frame: CoordinateFrameArgs,
    /// Folder for features and matches. An interrupted build, or a build with more images, computes only what is
    /// missing. It contains the same data on the images as the map: protect it in the same way. Default: nothing is
    /// stored.
    #[arg(long, value_name = "DIR")]
    work: Option<OutFolder>,
    #[command(flatten)]
    written: OutputArgs,
}

/// Selection of the image pairs to match.
#[derive(clap::Args)]
struct PairArgs {
    /// Match these image pairs and no others: two names per line, as in hloc's lists. Default: pairs that probably
    /// overlap, by poses and points.
    #[arg(long, value_name = "FILE")]
    pairs: Option<PathBuf>,
    /// Write the matched pairs as such a list. Default: not written.
    #[arg(long, value_name = "FILE")]
    out_pairs: Option<OutFile>,
}

pub(super) fn run(args: &BuildArgs, ui: &Ui) -> Outcome {
    if args.written.metres && args.posed.posed.is_none() {
        return Err(Failure::with_help(
            "--metres is for poses in metres, and structure from motion has no scale",
            "build the map without it, then transform it to metres with `veiloc map align`",
        ));
    }
    let mut others = Vec::new();
    let input = args.posed.read(ui, |names| {
        let (work, out) = (args.work.as_deref(), &args.written.out);
        let mut computed = args.sfm.models(names, work, out, &args.posed, ui)?;
        others = computed.models.split_off(1);
        Ok(computed)
    })?;
    input.check_masks(ui)?;
    let mut outcome = build_one(args, &input, &args.written.out, ui);
    for (number, images) in (2..).zip(others) {
        let folder = input.folder.clone();
        let part =
            PosedInput { images, folder, down: None, is_metric: false, names: None, args: &args.posed };
        // A part that is too small to be a map does not stop the others; the first failure is reported at the end.
        let built = build_one(args, &part, &numbered(&args.written.out, number), ui);
        outcome = outcome.and(built);
    }
    outcome
}

/// The file of another part: `hall-2.vmap` beside `hall.vmap`.
fn numbered(out: &Path, number: usize) -> PathBuf {
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    let ending = out.extension().map_or_else(String::new, |ending| format!(".{}", ending.to_string_lossy()));
    out.with_file_name(format!("{stem}-{number}{ending}"))
}

fn build_one(args: &BuildArgs, posed_input: &PosedInput<'_>, out: &Path, ui: &Ui) -> Outcome {
    if args.pairs.out_pairs.is_some() {
        posed_input.names().try_for_each(check_pair_name)?;
    }
    let options = args.extraction.options()?;
    let pairs = args.pairs.pairs.as_deref().map(read_pairs).transpose()?;
    if let (Some(path), Some(pairs)) = (&args.pairs.pairs, &pairs) {
        warn_of_unknown(path, pairs, posed_input.names(), ui);
    }
    let input = match &pairs {
        Some(pairs) => posed_input.input().with_pairs(pairs),
        None => posed_input.input(),
    };
    let input = input.on_other_coordinate_frame(args.coordinate_frame.on_other_coordinate_frame());
    let cache = args.work.as_deref().map(|folder| FolderCache::in_folder(folder, &options)).transpose()?;
    let input = match &cache {
        Some(cache) => input.with_cache(cache),
        None => input,
    };
    let (mut model, mut report) =
        veiloc_mapping::build(&input, &options, &Stages::new(ui)).map_err(with_remedy)?;
    if let Some(fault) = cache.and_then(|cache| cache.finish().err()) {
        ui.warn(format!(
            "the work folder is incomplete, and the missing part will be computed again: \
             {fault}"
        ));
    }
    model.down = args.written.down.or(posed_input.down);
    model.is_metric = args.written.metres || posed_input.is_metric;
    args.finish.finish(&mut model, &mut report.warnings, out, ui)?;
    veiloc_map::write(&model, out)?;
    warn_of_anchors(out, &model, ui);
    let output = InfoOutput {
        json: args.written.json,
        skipped: report.skipped,
        warnings: report.warnings,
        coordinate_frame: report.coordinate_frame,
        ..InfoOutput::default()
    };
    let outcome = output.print(out, ui)?;
    if let Some(path) = &args.pairs.out_pairs {
        write_pairs(path, report.pairs.iter().map(|(a, b)| (a.as_str(), b.as_str())))?;
        ui.info(format!("{}: {} pairs", path.display(), report.pairs.len()));
    }
    Ok(outcome)
}

/// Warns of pairs that are not matched, because an image of theirs is not mapped.
fn warn_of_unknown<'a>(
    path: &Path,
    pairs: &'a [(String, String)],
    mapped: impl Iterator<Item = &'a str>,
    ui: &Ui,
) {
    const SHOWN: usize = 5;
    let mapped = NameIndex::new(mapped.map(|name| (name, ())));
    let is_unknown = |name: &&String| mapped.get(name).is_none();
    let unknown: BTreeSet<&String> = pairs.iter().flat_map(|(a, b)| [a, b]).filter(is_unknown).collect();
    if unknown.is_empty() {
        return;
    }
    let left_out = pairs.iter().filter(|(a, b)| unknown.contains(a) || unknown.contains(b)).count();
    let shown: Vec<&str> = unknown.iter().take(SHOWN).map(|name| name.as_str()).collect();
    let more = match unknown.len().saturating_sub(SHOWN) {
        0 => String::new(),
        n => format!(" and {n} more"),
    };
    ui.warn(format_args!(
        "warning: {}: {left_out} of {} pairs are left out, because these images are not mapped: {}{more}",
        path.display(),
        pairs.len(),
        shown.join(", ")
    ));
}
