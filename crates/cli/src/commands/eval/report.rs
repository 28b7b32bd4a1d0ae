//! Comparison and output options of the `veiloc eval` commands.

use serde::Serialize;
use veiloc_evaluation::results::metrics::Threshold;
use veiloc_evaluation::results::{EvaluationDocument, table};
use veiloc_protocol::Scheme;

use crate::args::json_args::JsonArgs;
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::ui::Ui;

/// Comparison and output of `eval scene` and `eval pose`.
#[derive(clap::Args)]
pub(super) struct ReportArgs {
    /// Schemes to compare.
    #[arg(long, value_delimiter = ',', default_value = "points,random-lines,dcl", value_name = "SCHEME,…", value_parser = Scheme::of_tables)]
    pub(super) schemes: Vec<Scheme>,
    /// Thresholds of the recall columns, `translation/degrees` with the translation in map units.
    #[arg(long, value_delimiter = ',', default_value = "0.05/5,0.25/2", value_name = "T/DEG,…")]
    pub(super) thresholds: Vec<Threshold>,
    #[command(flatten)]
    json: JsonArgs,
}

impl ReportArgs {
    /// Prints the table and document of another evaluation.
    pub(super) fn print(&self, table: &str, document: &impl Serialize, ui: &Ui) -> Result<(), Failure> {
        self.json.print(table, document, ui)
    }

    /// Prints the table and the document; refuses a result without any localized query.
    pub(super) fn finish(&self, evaluation: &EvaluationDocument, ui: &Ui) -> Outcome {
        self.json.print(&table(&evaluation.schemes), evaluation, ui)?;
        let localized = evaluation.schemes.iter().any(|s| s.localized > 0);
        Ok(if localized { Exit::Success } else { Exit::Refused })
    }
}
