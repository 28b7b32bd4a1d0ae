//! `veiloc train positions`: the attention network that tells positions from all rows of a query.
use veiloc_evaluation::EvalError;
use veiloc_evaluation::audit::training::{PositionRun, PositionTask, Sees, position_table, train_positions};
use veiloc_protocol::{AngleBits, Scheme};
use veiloc_report::plots;

use super::attention::AttentionArgs;
use crate::exit::{Exit, Outcome};
use crate::files;
use crate::json_args::JsonArgs;
use crate::ui::Ui;

/// Train the attention network that tells positions from all rows of a query, descriptors and lines.
///
/// What it says is added to the guess from the single line, so that it begins as that guess. Images are obfuscated anew
/// every time one is drawn. Learns from the images of `--train`, keeps the step that tells most about those of
/// `--validate`, and says what it tells about each file of `--test`, in bits and in pixels beside the guess. Give three
/// different places. `--sees row` and `--sees line` train the same network without attention, for comparison.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    network: AttentionArgs,
    /// Scheme under which images are sent.
    #[arg(long, value_name = "SCHEME")]
    scheme: Scheme,
    /// What the network is shown.
    #[arg(long, value_enum, default_value = "set")]
    sees: Shown,
    /// Mirror half of the draws. Right for SIFT descriptors alone.
    #[arg(long)]
    mirror: bool,
    /// Show whole images only; else half of the draws are of a part of one.
    #[arg(long)]
    no_crop: bool,
    /// Bits of a line's angle, as a profile sets them.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u8).range(6..=16))]
    angle_bits: u8,
    #[command(flatten)]
    json: JsonArgs,
}

/// What the network is shown.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Shown {
    /// All rows of the query.
    Set,
    /// Each row alone.
    Row,
    /// The line of each row alone.
    Line,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let course = &args.network.course;
    let mut task = PositionTask::new(args.scheme).map_err(EvalError::from)?;
    task.sees = match args.sees {
        Shown::Set => Sees::Set,
        Shown::Row => Sees::Row,
        Shown::Line => Sees::Line,
    };
    (task.mirror, task.crop) = (args.mirror, !args.no_crop);
    task.angle_bits = AngleBits::new(args.angle_bits)?;
    let run = PositionRun { sets: args.network.sets(), task, options: args.network.options() };
    let earlier = course.earlier(ui)?;
    let words = |judged: f64| format!("{judged:+.4} bits told on validation images");
    let (network, state, document) =
        course.watched(ui, words, |observe| Ok(train_positions(&run, earlier, observe)?))?;
    course.write(&network.encode(), &state, ui)?;
    if let Some(path) = course.plot() {
        files::write(path, plots::positions(&document)?.as_bytes())?;
    }
    args.json.print(&position_table(&document), &document, ui)?;
    Ok(Exit::Success)
}
