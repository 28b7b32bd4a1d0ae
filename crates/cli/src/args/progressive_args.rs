//! `--progressive`, for all commands that send queries.

use veiloc_protocol::StopCriterion;

/// How many rows of a sealed query are sent.
#[derive(clap::Args)]
pub(crate) struct ProgressiveArgs {
    /// Send the query in steps: first 256 random rows, then twice as many, and so on, until the pose is trusted. Rows
    /// that are not sent reveal nothing. Each step repeats the rows of the steps before it, and the server and a
    /// network observer learn the number of steps (docs/reference/privacy-rules.md). Default: all rows at once.
    #[arg(long)]
    progressive: bool,
    /// Continue until the standard deviation of the position in its least certain direction is at most this value, map
    /// units. Default: stop at the first trusted pose.
    #[arg(long, value_name = "UNITS", requires = "progressive", value_parser = accuracy)]
    accuracy: Option<StopCriterion>,
}

fn accuracy(text: &str) -> Result<StopCriterion, String> {
    let number = text.parse::<f64>().ok();
    number.and_then(StopCriterion::accurate_to).ok_or_else(|| "a number above 0 is needed".to_owned())
}

impl ProgressiveArgs {
    /// Returns the stop criterion; `None` if all rows are sent at once.
    pub(crate) fn stop_criterion(&self) -> Option<StopCriterion> {
        self.progressive.then(|| self.accuracy.unwrap_or(StopCriterion::TRUSTED))
    }
}
