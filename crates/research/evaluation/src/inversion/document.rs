//! What a training gave: the stable JSON document, and the table for people.

use crate::results::text_table::TextTable;
use serde::Serialize;
use veiloc_attacks::training::{Course, CurvePoint, Trained};

use crate::inversion::example::Example;
use crate::inversion::inverter::Inverter;
use crate::inversion::task::InversionTask;

/// The document that `veiloc train inversion --json` writes.
#[derive(Debug, Clone, Serialize)]
pub struct InversionDocument {
    /// Version of this document; a field is never removed or given another meaning under the same number.
    pub version: u32,
    /// `train inversion`.
    pub command: &'static str,
    /// Images that were learned from, and that chose the step.
    pub images: [usize; 2],
    /// Keypoints of the images that were learned from.
    pub keypoints: usize,
    /// How the network is built: `unet` or `invsfm`.
    pub form: &'static str,
    /// What the network is given of places: `places`, `lines` or `bag`.
    pub sees: &'static str,
    /// Percent of an image's descriptors that at most stood in wrong places while it was learned from.
    pub wrong_percent: u8,
    /// Scheme of the lines; `points` where it sees none.
    pub scheme: String,
    /// Length of the descriptors.
    pub dimension: usize,
    /// Channels of the finest level.
    pub width: usize,
    /// Levels.
    pub depth: usize,
    /// Cells of the longer side.
    pub side: usize,
    /// Numbers that were learned.
    pub parameters: usize,
    /// Steps that were asked for.
    pub steps: usize,
    /// Images of a step.
    pub images_a_step: usize,
    /// Highest learning rate.
    pub learning_rate: f64,
    /// Decay of weights.
    pub weight_decay: f64,
    /// Seed of weights and draws.
    pub seed: u64,
    /// Steps done when the network was the best on the validation images.
    pub best_step: usize,
    /// Steps done; fewer than asked for when the training was broken off.
    pub steps_done: usize,
    /// Wall-clock seconds of this run, looks at the validation images included.
    pub seconds: f64,
    /// Every look at the validation images.
    pub curve: Vec<CurveRow>,
}

/// One look at the validation images.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct CurveRow {
    /// Steps done.
    pub step: usize,
    /// Mean loss of the steps since the last look.
    pub loss: f64,
    /// Mean PSNR of the validation images on the network's grid, decibels.
    pub psnr: f64,
}

impl From<&CurvePoint> for CurveRow {
    fn from(point: &CurvePoint) -> Self {
        Self { step: point.step, loss: point.loss, psnr: point.judged }
    }
}

impl InversionDocument {
    /// Of a training; `images` are those learned from and those that chose the step.
    pub fn new(
        trained: &Trained<Inverter>,
        (task, course): (&InversionTask, &Course),
        images: [&[Example]; 2],
        seconds: f64,
    ) -> Self {
        let wrong_percent = task.wrong_percent();
        let shape = trained.network.shape();
        Self {
            version: 1,
            command: "train inversion",
            images: images.map(<[Example]>::len),
            keypoints: images[0].iter().map(Example::keypoints).sum(),
            form: shape.form.name(),
            sees: shape.sees.name(),
            wrong_percent,
            scheme: trained.network.scheme().to_string(),
            dimension: shape.dimension,
            width: shape.width,
            depth: shape.depth,
            side: shape.side,
            parameters: trained.network.parameters(),
            steps: course.steps,
            images_a_step: course.images,
            learning_rate: course.learning_rate,
            weight_decay: course.weight_decay,
            seed: course.seed,
            best_step: trained.best_step,
            steps_done: trained.state.step(),
            seconds,
            curve: trained.curve.iter().map(CurveRow::from).collect(),
        }
    }
}

/// The curve as a table for people.
pub fn inversion_table(document: &InversionDocument) -> String {
    let mut table = TextTable::new(["step", "loss", "validation PSNR dB"], 0);
    for row in &document.curve {
        table.push(vec![row.step.to_string(), format!("{:.4}", row.loss), format!("{:.3}", row.psnr)]);
    }
    let [train, validate] = document.images;
    format!(
        "{}\n{} numbers ({}), given {}: learned from {train} images, best of {} steps on {validate}: {}.\n",
        table.render(),
        document.parameters,
        document.form,
        document.sees,
        document.steps_done,
        document.best_step
    )
}
