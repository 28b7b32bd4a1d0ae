//! `--report FILE`, for commands that can write an HTML report.

use crate::output::targets::OutFile;

/// Destination of the report, and its number of drawn queries.
#[derive(clap::Args)]
pub(crate) struct ReportFileArgs {
    /// Write a report into FILE: one HTML file without network access, with tables, curves, the scene in 3D, and single
    /// queries, worst first. Default: no report.
    #[arg(id = "report_file", long = "report", value_name = "FILE")]
    pub file: Option<OutFile>,
    /// Number of queries that the report draws with the lines that were sent, worst first; several scenes share this
    /// number.
    #[arg(id = "report_queries", long = "report-queries", value_name = "N", default_value_t = 16, requires = "report_file",
        value_parser = clap::value_parser!(u16).range(0..=1000))]
    pub queries: u16,
}
