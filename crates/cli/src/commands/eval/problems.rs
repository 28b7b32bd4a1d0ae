//! `veiloc eval problems`: correspondence sets from a place with known poses, for `eval pose` and for fitting.

use std::path::PathBuf;

use veiloc_eval::{ProblemSource, encode_lines, make_problems};

use crate::commands::localization_args::MatchArgs;
use crate::commands::map::ExtractionArgs;
use crate::exit::{Exit, Outcome};
use crate::files;
use crate::ui::{Bars, Ui};

/// Correspondence sets from a place with known poses, as `eval pose` reads them.
///
/// Builds a map from the images of the map list, matches every image of the query list with it, and writes the matches
/// with the true poses: one JSON object a line, gzipped when the name ends in `.gz`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Folder of a COLMAP model with cameras and poses, text or binary; its points are not used.
    #[arg(long, value_name = "DIR")]
    posed: PathBuf,
    /// Folder of the photographs.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    /// Names of the images the map is built from, one a line.
    #[arg(long, value_name = "FILE")]
    map_list: PathBuf,
    /// Names of the images that become problems, one a line.
    #[arg(long, value_name = "FILE")]
    query_list: PathBuf,
    /// Where the problems go.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Seed of the keypoints' dither.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    matching: MatchArgs,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let source = ProblemSource {
        posed: &args.posed,
        images: &args.images,
        map_list: &files::read_list(&args.map_list)?,
        query_list: &files::read_list(&args.query_list)?,
        build: &args.extraction.options(),
        localize: &args.matching.localize_options(),
        seed: args.seed,
    };
    let lines = make_problems(&source, &Bars::new(ui))?;
    let gzip = args.out.extension().is_some_and(|e| e == "gz");
    files::write(&args.out, &encode_lines(&lines, gzip)?)?;
    ui.say(format!("{}: {} problems", args.out.display(), lines.len()));
    Ok(Exit::Success)
}
