//! Progressive queries: the same words wherever queries are sent.

use veiloc_protocol::Enough;

/// How much of a sealed query is sent.
#[derive(clap::Args)]
pub(crate) struct ProgressiveArgs {
    /// Send the query in steps: 256 of its rows at random, then twice as many, and so on, only while the pose is not
    /// trusted. Rows that are not sent tell nobody anything; each step sends those before again, and the server, and who sees
    /// how much is sent, learns how many steps it took (docs/reference/privacy-rules.md). Default: all rows at once.
    #[arg(long)]
    progressive: bool,
    /// Go on until the position is known to this standard deviation in its least certain direction, map units. Default:
    /// the first trusted pose is enough.
    #[arg(long, value_name = "UNITS", requires = "progressive", value_parser = accuracy)]
    accuracy: Option<Enough>,
}

fn accuracy(text: &str) -> Result<Enough, String> {
    let number = text.parse::<f64>().ok();
    number.and_then(Enough::accurate_to).ok_or_else(|| "a number above 0 is needed".to_owned())
}

impl ProgressiveArgs {
    /// When to stop; `None` when all rows are sent at once.
    pub(crate) fn enough(&self) -> Option<Enough> {
        self.progressive.then(|| self.accuracy.unwrap_or(Enough::TRUSTED))
    }
}
