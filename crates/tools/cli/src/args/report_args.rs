//! `--report FILE`, for commands whose results can be looked at.

use std::path::PathBuf;

/// Where the report goes, and how much it draws.
#[derive(clap::Args)]
pub(crate) struct ReportFileArgs {
    /// Write a report into FILE: one HTML file that needs no network, with tables and curves, the place in 3D, and queries one by
    /// one, worst first. Default: none is written.
    #[arg(id = "report_file", long = "report", value_name = "FILE")]
    pub file: Option<PathBuf>,
    /// Queries that the report draws with the lines that were sent, worst first; with several places they share them.
    #[arg(id = "report_queries", long = "report-queries", value_name = "N", default_value_t = 16, requires = "report_file",
        value_parser = clap::value_parser!(u16).range(0..=1000))]
    pub queries: u16,
}
