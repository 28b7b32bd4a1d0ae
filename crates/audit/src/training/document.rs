//! What training gave: the stable JSON document, and the table for people.

use serde::Serialize;
use veiloc_attacks::network::{CurvePoint, TrainingOptions};

use veiloc_results::text_table::{TextTable, percent};

/// The document that `veiloc train neighbours --json` writes.
#[derive(Debug, Clone, Serialize)]
pub struct TrainingDocument {
    /// Version of this document; a field is never removed or given another meaning under the same number.
    pub version: u32,
    /// `train neighbours`.
    pub command: &'static str,
    /// Images that were learned from, that chose the step, and that the final figures are of.
    pub images: [usize; 3],
    /// Keypoints of the images that were learned from.
    pub keypoints: usize,
    /// How it was trained.
    pub options: OptionsRow,
    /// Numbers that were learned.
    pub parameters: usize,
    /// Steps done when the network was the best on the validation images.
    pub best_step: usize,
    /// Wall-clock seconds of the training, looks at the validation images included.
    pub seconds: f64,
    /// Every look at the validation images.
    pub curve: Vec<CurveRow>,
    /// The final figures.
    pub precision: Vec<PrecisionRow>,
}

/// Options of the training, as [`TrainingOptions`] has them.
#[derive(Debug, Clone, Serialize)]
#[expect(missing_docs, reason = "each is the option of the same name")]
pub struct OptionsRow {
    pub steps: usize,
    pub images: usize,
    pub keypoints: usize,
    pub neighbours: usize,
    pub width: usize,
    pub heads: usize,
    pub layers: usize,
    pub learning_rate: f64,
    pub weight_decay: f64,
    pub dropout: f64,
    pub seed: u64,
}

impl From<&TrainingOptions> for OptionsRow {
    fn from(o: &TrainingOptions) -> Self {
        Self {
            steps: o.steps,
            images: o.images,
            keypoints: o.keypoints,
            neighbours: o.neighbours,
            width: o.width,
            heads: o.heads,
            layers: o.layers,
            learning_rate: o.learning_rate,
            weight_decay: o.weight_decay,
            dropout: o.dropout,
            seed: o.seed,
        }
    }
}

/// One look at the validation images.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct CurveRow {
    /// Steps done.
    pub step: usize,
    /// Mean loss of the steps since the last look, natural logarithms.
    pub loss: f64,
    /// Precision at 20 on the validation images.
    pub precision_at_20: f64,
}

impl From<&CurvePoint> for CurveRow {
    fn from(point: &CurvePoint) -> Self {
        Self { step: point.step, loss: point.loss, precision_at_20: point.precision }
    }
}

/// How many of the neighbours that a predictor names are among the 20 nearest.
#[derive(Debug, Clone, Serialize)]
pub struct PrecisionRow {
    /// `validate` or `test`.
    pub part: &'static str,
    /// `network`, or `statistic`: canonical correlations learned from the same images.
    pub predictor: &'static str,
    /// Images.
    pub images: usize,
    /// Share of the 5 likeliest, 0 to 1.
    pub at_5: f64,
    /// The same of the 10 likeliest.
    pub at_10: f64,
    /// The same of the 20 likeliest.
    pub at_20: f64,
    /// What drawing at random would have.
    pub chance: f64,
}

/// The final figures as a table for people.
pub fn training_table(document: &TrainingDocument) -> String {
    let head = ["part", "predictor", "images", "at 5", "at 10", "at 20", "at random"];
    let mut table = TextTable::new(head, 2);
    for row in &document.precision {
        table.push(vec![
            row.part.to_owned(),
            row.predictor.to_owned(),
            row.images.to_string(),
            percent(row.at_5),
            percent(row.at_10),
            percent(row.at_20),
            percent(row.chance),
        ]);
    }
    let [train, validate, _] = document.images;
    format!(
        "{}\nNamed neighbours that are among the 20 nearest. Learned from {train} images, best of {} steps on {validate}: {}.\n",
        table.render(),
        document.options.steps,
        document.best_step
    )
}
