//! `veiloc eval tables`: formats result documents as the tables of a paper.

use std::path::PathBuf;

use veiloc_evaluation::results::metrics::Threshold;
use veiloc_evaluation::results::tables::{Cells, Format, TableData, TableOptions, tables};
use veiloc_map::text::read_text;
use veiloc_report::plots::{self, ErrorAxis};

use crate::exit::{Exit, Failure, Outcome};
use crate::files;
use crate::targets::OutFolder;
use crate::ui::Ui;

/// Print the results of an evaluation as the tables of a paper.
///
/// Errors of every scheme on every scene, beside published figures for the same data; 95 % intervals; the ablation of
/// the anchors if its schemes were run; times. Computes nothing but the tables.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The document, as written by `eval 7scenes|cambridge|aachen|scene --json FILE`.
    #[arg(value_name = "RESULTS.json")]
    results: PathBuf,
    /// Write Markdown (the default).
    #[arg(long, group = "format")]
    markdown: bool,
    /// Write LaTeX: `tabular` with the rules of `booktabs`.
    #[arg(long, group = "format")]
    latex: bool,
    /// Write CSV, one table after another.
    #[arg(long, group = "format")]
    csv: bool,
    /// Content of the cells: medians-recall, medians or recalls. Default: as in the paper for the data set.
    #[arg(long, value_name = "CELLS")]
    cells: Option<Cells>,
    /// Recall thresholds, map units and degrees. Default: the paper's thresholds for the data set.
    #[arg(long, value_delimiter = ',', value_name = "T/DEG,…")]
    thresholds: Vec<Threshold>,
    /// Leave published figures out.
    #[arg(long)]
    no_published: bool,
    /// Plot position.svg, orientation.svg (share of queries within a threshold) and times.svg into this folder.
    #[arg(long, value_name = "DIR")]
    plot: Option<OutFolder>,
    /// Number of bootstrap samples for the intervals.
    #[arg(long, default_value_t = 2000, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=1_000_000))]
    bootstrap_samples: u32,
    /// Seed of the bootstrap.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let refused = |what: &dyn std::fmt::Display| {
        Failure::with_help(
            format!("{}: {what}", args.results.display()),
            "give a file written by `eval 7scenes --json FILE` or another data-set command",
        )
    };
    let text = read_text(&args.results).map_err(|e| refused(&e))?;
    let data = TableData::parse(&text).map_err(|e| refused(&e))?;
    let options = TableOptions {
        format: match (args.latex, args.csv) {
            (true, _) => Format::Latex,
            (_, true) => Format::Csv,
            _ => Format::Markdown,
        },
        cells: args.cells,
        thresholds: args.thresholds.clone(),
        published: !args.no_published,
        bootstrap_samples: args.bootstrap_samples as usize,
        seed: args.seed,
    };
    ui.print(tables(&data, &options));
    if let Some(folder) = &args.plot {
        files::make_folder(folder)?;
        let drawn = [
            ("position.svg", plots::errors(&data, ErrorAxis::Position)?),
            ("orientation.svg", plots::errors(&data, ErrorAxis::Orientation)?),
            ("times.svg", plots::times(&data)?),
        ];
        for (name, svg) in drawn {
            files::write(&folder.join(name), svg.as_bytes())?;
        }
        ui.info(format!("{}: position.svg, orientation.svg, times.svg", folder.display()));
    }
    Ok(Exit::Success)
}
