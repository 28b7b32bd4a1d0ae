//! What trainings of attention networks have in common: files of keypoints, and the network's size.

use std::path::PathBuf;

use veiloc_evaluation::audit::training::{ImageSets, TrainingOptions};

use super::course::CourseArgs;

/// Arguments of every training of an attention network.
#[derive(clap::Args)]
pub(super) struct AttentionArgs {
    /// Keypoints with descriptors to learn from, as `eval keypoints` writes them.
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    train: Vec<PathBuf>,
    /// Keypoints of another place, by which the best step is chosen.
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    validate: Vec<PathBuf>,
    /// Keypoints of a third place, which the final figures are of.
    #[arg(long, num_args = 1.., value_name = "FILE")]
    test: Vec<PathBuf>,
    /// Validation images at most, evenly picked.
    #[arg(long, default_value_t = 4, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    validation_images: u32,
    #[command(flatten)]
    pub(super) course: CourseArgs,
    /// Keypoints drawn from each of them.
    #[arg(long, default_value_t = 512, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=8192))]
    keypoints: u32,
    /// Length of what stands for a keypoint within the network.
    #[arg(long, default_value_t = 96, value_name = "N")]
    width: u32,
    /// Heads of an attention layer; they divide the width.
    #[arg(long, default_value_t = 4, value_name = "N")]
    heads: u32,
    /// Attention layers.
    #[arg(long, default_value_t = 2, value_name = "N")]
    layers: u32,
    /// Share of entries dropped behind each half of a layer.
    #[arg(long, default_value_t = 0.1, value_name = "SHARE")]
    dropout: f64,
}

impl AttentionArgs {
    pub(super) fn sets(&self) -> ImageSets {
        ImageSets {
            train: self.train.clone(),
            validate: self.validate.clone(),
            test: self.test.clone(),
            validation_images: self.validation_images as usize,
        }
    }

    pub(super) fn options(&self) -> TrainingOptions {
        let course = self.course.course();
        let mut options = TrainingOptions::default();
        (options.steps, options.validate_every) = (course.steps, course.validate_every);
        (options.images, options.keypoints) = (course.images, self.keypoints as usize);
        (options.width, options.heads) = (self.width as usize, self.heads as usize);
        options.layers = self.layers as usize;
        (options.learning_rate, options.weight_decay) = (course.learning_rate, course.weight_decay);
        (options.dropout, options.seed) = (self.dropout, course.seed);
        options
    }
}
