//! `--json FILE`, for commands that also print a table.

use serde::Serialize;

use crate::output::exit::Failure;
use crate::output::files;
use crate::output::targets::OutFileOrStdout;
use crate::output::ui::Ui;

/// Destination of the JSON document.
#[derive(clap::Args)]
pub(crate) struct JsonArgs {
    /// Write the JSON document to FILE; without FILE, or with `-`, to stdout. Put it last when no FILE follows.
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-")]
    json: Option<OutFileOrStdout>,
}

impl JsonArgs {
    /// Returns whether the document goes to stdout, which then holds nothing else.
    pub(crate) fn takes_stdout(&self) -> bool {
        self.json.as_deref().is_some_and(files::is_standard)
    }

    /// Prints either the document or the table to stdout, never both.
    ///
    /// # Errors
    /// Stdout or the file cannot be written.
    pub(crate) fn print(&self, table: &str, document: &impl Serialize, ui: &Ui) -> Result<(), Failure> {
        match &self.json {
            Some(path) if files::is_standard(path) => {
                ui.info(table.trim_end());
                ui.json(document)
            }
            Some(path) => {
                files::write(path, (serde_json::to_string_pretty(document)? + "\n").as_bytes())?;
                ui.print(table);
                Ok(())
            }
            None => {
                ui.print(table);
                Ok(())
            }
        }
    }
}
