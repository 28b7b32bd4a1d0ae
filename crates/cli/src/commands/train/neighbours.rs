//! `veiloc train neighbours`: the attention network that tells neighbours from descriptors alone.

use std::path::PathBuf;

use crate::commands::json_args::JsonArgs;
use crate::exit::Outcome;
use crate::ui::Ui;

/// Train the attention network that tells neighbours from descriptors alone.
///
/// Learns from the images of `--train`, keeps the step that is best on those of `--validate`, and tells how many of
/// the neighbours it names on those of `--test` are true, beside the statistic of `attack --neighbours predicted`
/// learned from the same images. Give three different places. Needs a veiloc built with the feature `network`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Keypoints with descriptors to learn from, as `eval keypoints` writes them.
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    train: Vec<PathBuf>,
    /// Keypoints of another place, by which the best step is chosen.
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    validate: Vec<PathBuf>,
    /// Keypoints of a third place, which the final figures are of.
    #[arg(long, num_args = 1.., value_name = "FILE")]
    test: Vec<PathBuf>,
    /// The network's file.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Validation images at most, evenly picked.
    #[arg(long, default_value_t = 4, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    validation_images: u32,
    /// Steps of the optimizer.
    #[arg(long, default_value_t = 3000, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Steps from one look at the validation images to the next.
    #[arg(long, default_value_t = 250, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// Images of a step.
    #[arg(long, default_value_t = 2, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=256))]
    images: u32,
    /// Keypoints drawn from each of them.
    #[arg(long, default_value_t = 512, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=8192))]
    keypoints: u32,
    /// Nearest keypoints of an image that count as neighbours.
    #[arg(short, default_value_t = 20, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=1000))]
    k: u32,
    /// Length of an embedding.
    #[arg(long, default_value_t = 96, value_name = "N")]
    width: u32,
    /// Heads of an attention layer; they divide the width.
    #[arg(long, default_value_t = 4, value_name = "N")]
    heads: u32,
    /// Attention layers.
    #[arg(long, default_value_t = 2, value_name = "N")]
    layers: u32,
    /// Highest learning rate.
    #[arg(long, default_value_t = 1e-3, value_name = "RATE")]
    rate: f64,
    /// Decay of weights.
    #[arg(long, default_value_t = 0.01, value_name = "DECAY")]
    decay: f64,
    /// Share of entries dropped behind each half of a layer.
    #[arg(long, default_value_t = 0.1, value_name = "SHARE")]
    dropout: f64,
    /// Seed of weights and draws; equal seeds give equal networks.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// Draw loss and validation precision by step into FILE, as SVG.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    json: JsonArgs,
}

#[cfg(feature = "network")]
pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    training::run(args, ui)
}

#[cfg(not(feature = "network"))]
pub(super) fn run(_args: &Args, _ui: &Ui) -> Outcome {
    Err(crate::exit::Failure::with_help(
        "this veiloc was built without networks",
        "build it with `cargo build --release -p veiloc-cli --features network`",
    ))
}

#[cfg(feature = "network")]
mod training {
    //! What a build with networks does.

    use veiloc_audit::training::{TrainingOptions, TrainingRun, train_neighbours, training_table};
    use veiloc_report::plots;

    use super::Args;
    use crate::exit::{Exit, Outcome};
    use crate::files;
    use crate::ui::Ui;

    pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
        let mut run = TrainingRun {
            train: args.train.clone(),
            validate: args.validate.clone(),
            test: args.test.clone(),
            validation_images: args.validation_images as usize,
            options: TrainingOptions::default(),
        };
        let options = &mut run.options;
        (options.steps, options.validate_every) = (args.steps as usize, args.every as usize);
        (options.images, options.keypoints) = (args.images as usize, args.keypoints as usize);
        options.neighbours = args.k as usize;
        (options.width, options.heads) = (args.width as usize, args.heads as usize);
        options.layers = args.layers as usize;
        (options.learning_rate, options.weight_decay) = (args.rate, args.decay);
        (options.dropout, options.seed) = (args.dropout, args.seed);

        let total = u64::from(args.steps);
        let stage = ui.stage("Training", total);
        let (network, document) = train_neighbours(&run, |step, point| {
            stage.reach(step as u64, total);
            if let Some(p) = point {
                stage.suspend(|| {
                    let percent = 100.0 * p.precision;
                    ui.say(format!(
                        "step {step}: loss {:.4}, validation precision at 20 {percent:.2} %",
                        p.loss
                    ));
                });
            }
        })?;
        stage.finish();
        files::write(&args.out, &network.encode())?;
        if let Some(path) = &args.plot {
            files::write(path, plots::training(&document)?.as_bytes())?;
        }
        args.json.print(&training_table(&document), &document, ui)?;
        Ok(Exit::Success)
    }
}
