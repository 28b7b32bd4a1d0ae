//! `veiloc train neighbours`: the attention network that tells neighbours from descriptors alone.

use veiloc_evaluation::audit::training::{NeighbourRun, train_neighbours, training_table};
use veiloc_report::plots;

use super::attention::AttentionArgs;
use crate::exit::{Exit, Outcome};
use crate::files;
use crate::json_args::JsonArgs;
use crate::ui::Ui;

/// Train the attention network that tells neighbours from descriptors alone.
///
/// Learns from the images of `--train`, keeps the step that is best on those of `--validate`, and tells how many of
/// the neighbours it names on those of `--test` are true, beside the statistic of `attack --neighbours predicted`
/// learned from the same images. Give three different places.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    network: AttentionArgs,
    /// Nearest keypoints of an image that count as neighbours.
    #[arg(short, default_value_t = 20, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=1000))]
    k: u32,
    #[command(flatten)]
    json: JsonArgs,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let course = &args.network.course;
    let run = NeighbourRun {
        sets: args.network.sets(),
        neighbours: args.k as usize,
        options: args.network.options(),
    };
    let earlier = course.earlier(ui)?;
    let words = |judged: f64| format!("validation precision at 20 {:.2} %", 100.0 * judged);
    let (network, state, document) =
        course.watched(ui, words, |observe| Ok(train_neighbours(&run, earlier, observe)?))?;
    course.write(&network.encode(), &state, ui)?;
    if let Some(path) = course.plot() {
        files::write(path, plots::training(&document)?.as_bytes())?;
    }
    args.json.print(&training_table(&document), &document, ui)?;
    Ok(Exit::Success)
}
