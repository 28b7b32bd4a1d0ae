//! What trainings gave: the stable JSON documents, and the tables for people.

use serde::Serialize;
use veiloc_attacks::learned::positions::Told;
use veiloc_attacks::learned::{CurvePoint, TrainingOptions};

use crate::results::text_table::{TextTable, percent};

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
    /// Steps done; fewer than the options say when the training was broken off.
    pub steps_done: usize,
    /// Wall-clock seconds of this run, looks at the validation images included.
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
    #[serde(skip_serializing_if = "Option::is_none")]
    pub neighbours: Option<usize>,
    pub width: usize,
    pub heads: usize,
    pub layers: usize,
    pub learning_rate: f64,
    pub weight_decay: f64,
    pub dropout: f64,
    pub seed: u64,
}

impl OptionsRow {
    pub(super) fn of(o: &TrainingOptions, neighbours: Option<usize>) -> Self {
        Self {
            steps: o.steps,
            images: o.images,
            keypoints: o.keypoints,
            neighbours,
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
        Self { step: point.step, loss: point.loss, precision_at_20: point.judged }
    }
}

/// How many of the neighbours that a predictor names are among the 20 nearest.
#[derive(Debug, Clone, Serialize)]
pub struct PrecisionRow {
    /// `validate` or `test`.
    pub part: &'static str,
    /// `network`, or `statistic`: canonical correlations learned from the same images. With `, angles` behind, only rows
    /// whose angles under the paper's layout are near count as candidates; `angles`: drawn at random from those.
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
    /// [`Self::at_20`] of each image.
    pub by_image: Vec<f64>,
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
        document.steps_done,
        document.best_step
    )
}

/// The document that `veiloc train positions --json` writes.
#[derive(Debug, Clone, Serialize)]
pub struct PositionDocument {
    /// Version of this document; a field is never removed or given another meaning under the same number.
    pub version: u32,
    /// `train positions`.
    pub command: &'static str,
    /// Obfuscation scheme.
    pub scheme: String,
    /// What the network is shown: `set`, `row` or `line`.
    pub sees: String,
    /// Whether half of the draws were of a part of an image.
    pub crop: bool,
    /// Whether half of the draws were mirrored.
    pub mirror: bool,
    /// Images that were learned from, that chose the step, and that the final figures are of.
    pub images: [usize; 3],
    /// Keypoints of the images that were learned from.
    pub keypoints: usize,
    /// How it was trained.
    pub options: OptionsRow,
    /// Numbers that were learned.
    pub parameters: usize,
    /// Steps done when the network told most about the validation images.
    pub best_step: usize,
    /// Steps done; fewer than the options say when the training was broken off.
    pub steps_done: usize,
    /// Wall-clock seconds of this run, looks at the validation images included.
    pub seconds: f64,
    /// Every look at the validation images.
    pub curve: Vec<PositionCurveRow>,
    /// The final figures.
    pub told: Vec<ToldRow>,
}

/// One look at the validation images.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct PositionCurveRow {
    /// Steps done.
    pub step: usize,
    /// Mean loss of the steps since the last look, natural logarithms.
    pub loss: f64,
    /// [`Told::information`] of the validation images.
    pub information_bits: f64,
}

impl From<&CurvePoint> for PositionCurveRow {
    fn from(point: &CurvePoint) -> Self {
        Self { step: point.step, loss: point.loss, information_bits: point.judged }
    }
}

/// What a network of positions tells of some images.
#[derive(Debug, Clone, Serialize)]
pub struct ToldRow {
    /// `validate` or `test`.
    pub part: &'static str,
    /// The file.
    pub data: String,
    /// Images.
    pub images: usize,
    /// Keypoints.
    pub keypoints: usize,
    /// Bits told about the bin in which a keypoint is, beyond the guess.
    pub information_bits: f64,
    /// Bits over the guess of the places of least expected error.
    pub bits_over_prior: f64,
    /// The same of the expected places .
    pub bits_of_mean: f64,
    /// [`Self::bits_over_prior`] of a network that has learned nothing: what is gained is the difference.
    pub bits_untrained: f64,
    /// Median error, pixels.
    pub median_px: f64,
    /// Share of keypoints with an error under 10 px, 0 to 1.
    pub under_10px: f64,
    /// The same under 30 px.
    pub under_30px: f64,
    /// Median error of the guess, pixels.
    pub guess_median_px: f64,
    /// Share of keypoints with an error of the guess under 30 px, 0 to 1.
    pub guess_under_30px: f64,
    /// [`Self::information_bits`] of each image.
    pub by_image: Vec<f64>,
}

impl ToldRow {
    pub(super) fn new(part: &'static str, data: String, images: usize, told: &Told) -> Self {
        Self {
            part,
            data,
            images,
            keypoints: told.keypoints,
            information_bits: told.information,
            bits_over_prior: told.bits,
            bits_of_mean: told.bits_of_mean,
            bits_untrained: told.bits_untrained,
            median_px: told.errors.median_px,
            under_10px: told.errors.under_10px,
            under_30px: told.errors.under_30px,
            guess_median_px: told.guess.median_px,
            guess_under_30px: told.guess.under_30px,
            by_image: told.by_image.clone(),
        }
    }
}

/// The final figures as a table for people.
pub fn position_table(document: &PositionDocument) -> String {
    let head = [
        "part",
        "data",
        "images",
        "told",
        "bits",
        "untrained",
        "median px",
        "< 10 px",
        "< 30 px",
        "guess px",
        "< 30 px",
    ];
    let mut table = TextTable::new(head, 2);
    for row in &document.told {
        table.push(vec![
            row.part.to_owned(),
            row.data.clone(),
            row.images.to_string(),
            format!("{:+.3}", row.information_bits),
            format!("{:+.3}", row.bits_over_prior),
            format!("{:+.3}", row.bits_untrained),
            format!("{:.1}", row.median_px),
            percent(row.under_10px),
            percent(row.under_30px),
            format!("{:.1}", row.guess_median_px),
            percent(row.guess_under_30px),
        ]);
    }
    let [train, validate, _] = document.images;
    format!(
        "{}\n{}, seeing the {}: bits told about a position, and bits of error over the guess, beside those of the same answers untrained. Learned from {train} images, best of {} steps on {validate}: {}.\n",
        table.render(),
        document.scheme,
        document.sees,
        document.steps_done,
        document.best_step
    )
}
