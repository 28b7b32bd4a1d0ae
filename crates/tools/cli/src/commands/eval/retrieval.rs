//! `veiloc eval retrieval`: image retrieval as maps grow.

use std::path::{Path, PathBuf};

use serde::Serialize;
use veiloc_evaluation::retrieval::{RetrievalEvaluation, RetrievalRow, evaluate_retrieval, table};
use veiloc_map::MapFile;

use crate::exit::{Exit, Outcome};
use crate::feature_args::MapFeatureArgs;
use crate::items::{self, Item};
use crate::json_args::JsonArgs;
use crate::lists;
use crate::stages::Stages;
use crate::targets::OutFolder;
use crate::ui::Ui;

/// Measure cost and recall of image retrieval as maps grow.
///
/// The database holds the images of the map, out-of-map images, and synthetic global descriptors, drawn from the
/// distribution of all real ones, up to each size. Every query is searched twice: exhaustively, and with the index that
/// large maps use.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The map that is searched.
    #[arg(long, value_name = "FILE")]
    map: PathBuf,
    /// Folder of the queries, JPEG or PNG.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    /// Names of the queries, one per line, relative to the folder; cameras after the names are ignored. Default: all
    /// images in it and in its sub-folders.
    #[arg(long, value_name = "FILE")]
    query_list: Option<PathBuf>,
    /// Folder of out-of-map images that are added to those of the map. Default: none.
    #[arg(long, value_name = "DIR")]
    distractors: Option<PathBuf>,
    /// Sizes of the database in images; a global descriptor takes about 4 kB.
    #[arg(long, value_delimiter = ',', default_value = "10000,100000,1000000", value_name = "N,…")]
    sizes: Vec<usize>,
    /// Number of retrieved images.
    #[arg(long, default_value_t = 10, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    retrieve: u32,
    /// Seed of the synthetic global descriptors.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// Folder for the global descriptors as NumPy files, for a comparison with other indexes
    /// (`study scale usearch`): `searched.npy` of the largest size and `queries.npy`, int8, one row per image.
    #[arg(long, value_name = "DIR")]
    save: Option<OutFolder>,
    #[command(flatten)]
    features: MapFeatureArgs,
    #[command(flatten)]
    json: JsonArgs,
}

/// Retrieval among the images of a map, out-of-map images, and synthetic global descriptors.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct RetrievalDocument {
    /// 1.
    version: u32,
    /// `eval retrieval`.
    command: &'static str,
    /// The map, as given.
    map: String,
    /// Seed of the synthetic global descriptors.
    seed: u64,
    /// Number of query images.
    queries: usize,
    /// Number of out-of-map images.
    out_of_map: usize,
    /// One entry per database size and search method.
    rows: Vec<RetrievalRow>,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let map = MapFile::open(&args.map)?;
    let gathered = |items: Vec<Item>| -> Result<Vec<PathBuf>, crate::exit::Failure> {
        items::refuse_bad(&items)?;
        Ok(items.into_iter().map(|item| item.path).collect())
    };
    let queries = match &args.query_list {
        None => gathered(items::expand_images(std::slice::from_ref(&args.images), ui))?,
        Some(list) => {
            let listed = lists::read_with_cameras(list)?;
            gathered(items::files_of_list(&args.images, listed.iter().map(|l| l.name.as_str())))?
        }
    };
    let distractors = match &args.distractors {
        None => Vec::new(),
        Some(folder) => gathered(items::expand_images(std::slice::from_ref(folder), ui))?,
    };
    let extractors = args.features.extractors(map.profile())?;
    let extractor = extractors.of_kind(map.profile().descriptor_kind())?;
    let evaluation = RetrievalEvaluation {
        queries,
        distractors,
        sizes: args.sizes.clone(),
        retrieve: args.retrieve as usize,
        seed: args.seed,
        save: args.save.as_deref().map(Path::to_owned),
    };
    let rows = evaluate_retrieval(&map, extractor, &evaluation, &Stages::new(ui))?;
    let text = table(&rows);
    let document = RetrievalDocument {
        version: 1,
        command: "eval retrieval",
        map: args.map.display().to_string(),
        seed: args.seed,
        queries: evaluation.queries.len(),
        out_of_map: evaluation.distractors.len(),
        rows,
    };
    args.json.print(&text, &document, ui)?;
    Ok(Exit::Success)
}
