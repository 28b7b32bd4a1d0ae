//! `veiloc eval aachen`.

use std::path::PathBuf;

use veiloc_datasets::aachen::{AachenVersion, CONDITIONS, read, read_poses};

use super::run::refused;
use super::submission::write_submissions;
use super::{DataSet, DataSetArgs, evaluate};
use crate::exit::Outcome;
use crate::targets::OutFile;
use crate::ui::Ui;

/// Aachen Day-Night: build a map of the database images and localize the day and night queries.
///
/// The poses of the queries are not published: `--submission` writes the files that https://www.visuallocalization.net
/// evaluates.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    data_set: DataSetArgs,
    /// Version of the data set, 1 (the paper's) or 1.1. Default: 1.1 if its model exists, otherwise 1.
    #[arg(long, value_name = "VERSION")]
    version: Option<AachenVersion>,
    /// Query conditions, named as their lists.
    #[arg(long, value_delimiter = ',', default_values_t = CONDITIONS.map(str::to_owned), value_name = "CONDITION,…")]
    conditions: Vec<String>,
    /// True poses of the queries, `name qw qx qy qz tx ty tz` per line, world to camera, for copies of the data set
    /// with known poses. Default: no errors are computed.
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Write the poses for visuallocalization.net, `name qw qx qy qz tx ty tz` per line, with file names without
    /// folders; with several schemes one file per scheme, with the scheme appended to the name.
    #[arg(long, value_name = "FILE")]
    submission: Option<OutFile>,
}

const DATA_SET: DataSet = DataSet {
    command: "eval aachen",
    thresholds: &[(0.25, 2.0), (0.5, 5.0), (5.0, 10.0)],
    paper_max_error_px: 8.0,
};

pub(in crate::commands::eval) fn run(args: &Args, ui: &Ui) -> Outcome {
    let root = &args.data_set.root;
    let version = args.version.unwrap_or_else(|| AachenVersion::in_folder(root));
    let truth = args.truth.as_deref().map(read_poses).transpose().map_err(refused)?;
    let conditions = &args.conditions;
    let read = |_: &str| read(root, version, conditions, truth.as_ref(), args.data_set.missing());
    let (document, exit) = evaluate(&DATA_SET, &["aachen".to_owned()], &read, &args.data_set, ui)?;
    if let Some(path) = &args.submission {
        write_submissions(path, &document, ui)?;
    }
    Ok(exit)
}
