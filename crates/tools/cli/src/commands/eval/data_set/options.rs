//! Options that the data-set commands share.

use std::path::PathBuf;

use veiloc_datasets::MissingImages;
use veiloc_evaluation::results::metrics::Threshold;
use veiloc_protocol::{DclLayout, Scheme};

use super::adversaries::AttackArgs;
use crate::commands::eval::html::HtmlArgs;
use crate::exit::Failure;
use crate::extraction_args::ExtractionArgs;
use crate::json_args::JsonArgs;
use crate::localization_args::{MatchArgs, PoseArgs};
use crate::targets::OutFolder;

/// Selection of scenes, map building, and localization of the queries.
#[derive(clap::Args)]
pub(in crate::commands::eval) struct DataSetArgs {
    /// Folder of the data set.
    #[arg(long, value_name = "DIR")]
    pub(super) root: PathBuf,
    /// Evaluate the existing images if some are missing. Figures are then not compared with published ones. Default:
    /// missing images are an error.
    #[arg(long)]
    available_only: bool,
    /// Schemes to compare; `dcl:s=2`, `dcl:s=3` and `dcl:horizontal` are those of the paper's ablations.
    #[arg(long, value_delimiter = ',', default_value = "points,random-lines,dcl", value_name = "SCHEME,…")]
    pub(super) schemes: Vec<Scheme>,
    /// Thresholds of the recall columns, `translation/degrees` with the translation in map units. Default: the paper's
    /// thresholds for the data set.
    #[arg(long, value_delimiter = ',', value_name = "T/DEG,…")]
    thresholds: Vec<Threshold>,
    /// Estimate poses as in the paper: msac, p6lp, equal match weights, dcl with the paper's halves, and the paper's inlier threshold for the data
    /// set (4 pixels for 7Scenes, 18 for Cambridge, 8 for Aachen; lines divided by √2). Default: likelihood, as in the
    /// service.
    #[arg(long, conflicts_with_all = ["score", "solver", "max_error"])]
    pub(super) paper: bool,
    /// Folder for intermediate results: features and matches of map images, maps, and the result of each finished
    /// query. An interrupted run continues from there, and results for the same images and options are not computed
    /// again. Default: nothing is stored.
    #[arg(long, value_name = "DIR")]
    pub(super) work: Option<OutFolder>,
    /// Queries that are localized in parallel. Default: one per core; times are then those of a loaded machine. Use 1
    /// to report times.
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
    /// The schemes; with the paper's settings `dcl` has the paper's layout.
    pub(super) fn schemes(&self) -> Vec<Scheme> {
        let of_paper = |scheme: &Scheme| match scheme {
            _ if self.paper && *scheme == Scheme::default() => Scheme::Dcl(DclLayout::VERTICAL),
            other => *other,
        };
        self.schemes.iter().map(of_paper).collect()
    }

    /// How missing images are handled.
    pub(super) const fn missing(&self) -> MissingImages {
        if self.available_only { MissingImages::LeaveOut } else { MissingImages::Refuse }
    }

    /// Returns the given thresholds, or the data set's.
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

/// Returns the number of cores that this program may use.
pub(super) fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}
