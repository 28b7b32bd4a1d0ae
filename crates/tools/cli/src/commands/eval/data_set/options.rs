//! What the data sets have in common on the command line.

use std::path::PathBuf;

use veiloc_datasets::MissingImages;
use veiloc_evaluation::results::metrics::Threshold;
use veiloc_protocol::Scheme;

use super::adversaries::AttackArgs;
use crate::commands::eval::html::HtmlArgs;
use crate::exit::Failure;
use crate::extraction_args::ExtractionArgs;
use crate::json_args::JsonArgs;
use crate::localization_args::{MatchArgs, PoseArgs};

/// Which places, how maps are built, and how queries are localized in them.
#[derive(clap::Args)]
pub(in crate::commands::eval) struct DataSetArgs {
    /// Folder of the data set.
    #[arg(long, value_name = "DIR")]
    pub(super) root: PathBuf,
    /// Evaluate the images that are there, when some are missing. Figures are not compared with those of others then. Default:
    /// missing images are refused.
    #[arg(long)]
    available_only: bool,
    /// Schemes to compare; `dcl:s=2`, `dcl:s=3` and `dcl:horizontal` are those of the paper's ablations.
    #[arg(long, value_delimiter = ',', default_value = "points,random-lines,dcl", value_name = "SCHEME,…")]
    pub(super) schemes: Vec<Scheme>,
    /// Bounds of the recall columns, `translation/degrees` with the translation in map units. Default: those that the paper
    /// has for the data set.
    #[arg(long, value_delimiter = ',', value_name = "T/DEG,…")]
    thresholds: Vec<Threshold>,
    /// Estimate poses as the paper does: msac, p6lp, all matches alike, and its inlier threshold for the data set (4 pixels for
    /// 7Scenes, 18 for Cambridge, 8 for Aachen; lines divided by √2). Default: the likelihood, as in service.
    #[arg(long, conflicts_with_all = ["score", "solver", "max_error"])]
    pub(super) paper: bool,
    /// Folder for what is computed: features and matches of map images, maps, and the results of each query as soon as it is finished. A run that was interrupted
    /// goes on from there, and what the same images and options gave before is not computed again. Default: nothing is kept.
    #[arg(long, value_name = "DIR")]
    pub(super) work: Option<PathBuf>,
    /// Queries that are localized at the same time. Default: as many as there are cores; times are those of a busy machine
    /// then, and 1 gives times to report.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    pub(super) pose: PoseArgs,
    #[command(flatten)]
    pub(super) matching: MatchArgs,
    #[command(flatten)]
    pub(super) attack: AttackArgs,
    #[command(flatten)]
    pub(super) html: HtmlArgs,
    #[command(flatten)]
    pub(super) json: JsonArgs,
}

impl DataSetArgs {
    /// What is done about images that are missing.
    pub(super) const fn missing(&self) -> MissingImages {
        if self.available_only { MissingImages::LeaveOut } else { MissingImages::Refuse }
    }

    /// Those asked for, or the data set's.
    pub(super) fn thresholds(&self, of_data_set: &[(f64, f64)]) -> Vec<Threshold> {
        if !self.thresholds.is_empty() {
            return self.thresholds.clone();
        }
        let of = |(translation, rotation_deg): &(f64, f64)| Threshold {
            translation: *translation,
            rotation_deg: *rotation_deg,
        };
        of_data_set.iter().map(of).collect()
    }

    pub(super) fn jobs(&self) -> usize {
        self.jobs.map_or_else(cores, usize::from)
    }

    pub(super) fn build(&self) -> Result<veiloc_mapping::BuildOptions, Failure> {
        self.extraction.options()
    }
}

/// Cores that this program may use.
pub(super) fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}
