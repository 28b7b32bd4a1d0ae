//! `veiloc eval compare`: compares two runs on the same queries and tests which differences are significant.

use std::path::{Path, PathBuf};

use serde::Serialize;
use veiloc_evaluation::results::comparison::{Comparison, ComparisonOptions, Run, compare};
use veiloc_evaluation::results::metrics::Threshold;
use veiloc_map::text::read_text;

use crate::exit::{Exit, Failure, Outcome};
use crate::json_args::JsonArgs;
use crate::ui::Ui;

/// Compare two runs on the same queries and report which differences are significant.
///
/// Queries are paired by name and seed. For each figure the table has both runs, the difference, and its 95 %
/// confidence interval from a paired bootstrap over queries. A figure is called better only if its interval excludes
/// zero. Frames of one trajectory are correlated, and the bootstrap ignores this: its interval is rather too narrow.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Document of a run, as written by `eval scene --json` and `eval pose --json`.
    #[arg(value_name = "A.json")]
    a: PathBuf,
    /// Document of the other run.
    #[arg(value_name = "B.json")]
    b: PathBuf,
    /// Compare only this row or scheme, named as in the table. Default: all rows that occur in both documents.
    #[arg(long, value_name = "ROW")]
    row: Option<String>,
    /// Compare it with this row or scheme of B; B may be the same file. Default: the row of the same name.
    #[arg(long, value_name = "ROW", requires = "row")]
    against: Option<String>,
    /// Recall thresholds, map units and degrees. Default: those that both documents contain.
    #[arg(long, value_delimiter = ',', value_name = "T/DEG,…")]
    thresholds: Vec<Threshold>,
    /// Number of bootstrap samples.
    #[arg(long, default_value_t = 10_000, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=1_000_000))]
    bootstrap_samples: u32,
    /// Seed of the bootstrap.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    #[command(flatten)]
    json: JsonArgs,
}

/// Two documents of `eval scene`, `eval pose`, `eval 7scenes`, `eval cambridge` or `eval aachen`, paired by query and
/// seed. An interval holds 95 % of the differences over bootstrap samples, which draw queries with replacement, in both
/// runs at once.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct CompareDocument {
    /// 1.
    version: u32,
    /// `eval compare`.
    command: &'static str,
    /// File of the first run, as given.
    a: String,
    /// File of the second run, as given.
    b: String,
    /// Names of the data of the first run.
    data_a: Vec<String>,
    /// Names of the data of the second run.
    data_b: Vec<String>,
    #[serde(flatten)]
    comparison: Comparison,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let (a, b) = (read(&args.a)?, read(&args.b)?);
    if a.data() != b.data() {
        ui.warn(format!("A was evaluated on {}, and B on {}", a.data().join(", "), b.data().join(", ")));
    }
    let options = ComparisonOptions {
        rows: [args.row.clone(), args.against.clone()],
        thresholds: args.thresholds.clone(),
        draws: args.bootstrap_samples as usize,
        seed: args.seed,
    };
    let comparison = compare(&a, &b, &options).map_err(|error| {
        Failure::with_help(
            error.to_string(),
            "give two runs on the same queries; --row and --against select rows of different names",
        )
    })?;
    let text = comparison.table();
    let document = CompareDocument {
        version: 1,
        command: "eval compare",
        a: args.a.display().to_string(),
        b: args.b.display().to_string(),
        data_a: a.data().to_vec(),
        data_b: b.data().to_vec(),
        comparison,
    };
    args.json.print(&text, &document, ui)?;
    Ok(Exit::Success)
}

fn read(path: &Path) -> Result<Run, Failure> {
    let text = read_text(path).map_err(|e| {
        Failure::with_help(format!("{}: {e}", path.display()), "give a file written by --json")
    })?;
    Run::parse(&text).map_err(|error| {
        Failure::with_help(
            format!("{}: {error}", path.display()),
            "give a file written by `eval scene --json FILE`",
        )
    })
}
