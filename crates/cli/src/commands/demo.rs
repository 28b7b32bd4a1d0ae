//! `veiloc demo`: everything at once, on a place that renders itself.

use std::path::PathBuf;
use std::time::Instant;

use veiloc_audit::attacks_table;
use veiloc_demo::{DemoOptions, run_demo};
use veiloc_results::table;

use crate::exit::{Exit, Outcome};
use crate::stages::Stages;
use crate::ui::Ui;

/// Render a place, map it, localize hidden queries, attack them, write a report.
///
/// Needs no data and no network. Everything after the renderer is what real photographs go through, from pixels on.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Folder for the images, the map, the sealed queries and the report.
    #[arg(long, default_value = "out/demo", value_name = "DIR")]
    out: PathBuf,
    /// Seed of the place and of every random choice.
    #[arg(long, default_value_t = 7, value_name = "N")]
    seed: u64,
    /// Print the JSON document of the evaluation and the attacks to stdout.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    let started = Instant::now();
    let options = DemoOptions::new(args.out.clone(), args.seed);
    let demo = run_demo(&options, &Stages::new(ui))?;
    if args.json {
        ui.json(&demo.document)?;
    } else {
        ui.print(table(&demo.document.evaluation.schemes));
        ui.print("\n");
        ui.print(attacks_table(&demo.document.attacks));
    }
    ui.say(format!(
        "\nReport: {} (open it in a browser). Done in {:.0} s.",
        demo.report.display(),
        started.elapsed().as_secs_f64()
    ));
    Ok(Exit::Success)
}
