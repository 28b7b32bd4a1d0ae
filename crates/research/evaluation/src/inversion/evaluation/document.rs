//! What an evaluation found: the stable JSON document, and the table for people.

use crate::results::text_table::TextTable;
use serde::Serialize;

use super::beliefs::PosePriors;
use super::judges::Scores;
use crate::inversion::inverter::Inverter;

/// The document that `veiloc eval inversion --json` writes.
#[derive(Debug, Clone, Serialize)]
pub struct EvaluationDocument {
    /// Version of this document; a field is never removed or given another meaning under the same number.
    pub version: u32,
    /// `eval inversion`.
    pub command: &'static str,
    /// Images.
    pub images: usize,
    /// Neighbours a keypoint that attacks are told.
    pub k: usize,
    /// Seed of obfuscation and attacks.
    pub seed: u64,
    /// The networks, in the order given.
    pub networks: Vec<NetworkRow>,
    /// Means over images.
    pub summary: Vec<SummaryRow>,
    /// One for each image, scheme and attack.
    pub rows: Vec<RebuiltRow>,
}

/// A network.
#[derive(Debug, Clone, Serialize)]
pub struct NetworkRow {
    /// How it is built: `unet` or `invsfm`.
    pub form: &'static str,
    /// What it is given of places: `places`, `lines` or `bag`.
    pub sees: &'static str,
    /// Scheme of the lines; `points` where it sees none.
    pub scheme: String,
    /// Channels of the finest level.
    pub width: usize,
    /// Levels.
    pub depth: usize,
    /// Cells of the longer side.
    pub side: usize,
    /// Numbers that were learned.
    pub parameters: usize,
}

impl From<&Inverter> for NetworkRow {
    fn from(network: &Inverter) -> Self {
        let shape = network.shape();
        Self {
            form: shape.form.name(),
            sees: shape.sees.name(),
            scheme: network.scheme().to_string(),
            width: shape.width,
            depth: shape.depth,
            side: shape.side,
            parameters: network.parameters(),
        }
    }
}

/// An image made of another's descriptors, and how alike it is.
#[derive(Debug, Clone, Serialize)]
pub struct RebuiltRow {
    /// The image.
    pub image: String,
    /// Scheme it was sent under; `bag` for descriptors alone, `nothing` for no descriptor at all.
    pub scheme: String,
    /// `none` where nothing need be recovered, `guess`, `closed-form` and `graph` with true neighbours, `realistic`, or
    /// `lines` for a network that is given the lines themselves.
    pub attack: &'static str,
    /// Peak signal-to-noise ratio, decibels.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// LPIPS; `null` without its weights.
    pub lpips: Option<f64>,
    /// Distance of features of SuperPoint's encoder; `null` without its weights.
    pub feature_distance: Option<f64>,
    /// Objects found in the original; `null` without a detector.
    pub objects: Option<usize>,
    /// Of those, found again.
    pub objects_found: Option<usize>,
    /// Mean error of the positions that the network was given, pixels; `null` where it was given none.
    pub mean_px: Option<f64>,
}

/// Means over images.
#[derive(Debug, Clone, Serialize)]
pub struct SummaryRow {
    /// As in [`RebuiltRow`].
    pub scheme: String,
    /// As in [`RebuiltRow`].
    pub attack: &'static str,
    /// Which realistic attack was the best.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
    /// Mean error of the positions, over images, pixels.
    pub mean_px: Option<f64>,
    /// Median over all keypoints of all images, pixels.
    pub median_px: Option<f64>,
    /// Means of the rows.
    pub psnr: f64,
    /// Mean of the rows.
    pub ssim: f64,
    /// Mean of the rows.
    pub lpips: Option<f64>,
    /// Mean of the rows.
    pub feature_distance: Option<f64>,
    /// Sum of the rows.
    pub objects: Option<usize>,
    /// Sum of the rows.
    pub objects_found: Option<usize>,
    /// How often the network believes a keypoint that was put where it belongs more than one that was not, 0.5 by chance; `null`
    /// where it judges no places, or all are right or wrong.
    pub told_apart: Option<f64>,
}

/// What was put through a network: its name in rows, and errors of positions by image, `[images][N]`.
pub(super) struct Column {
    pub(super) scheme: String,
    pub(super) attack: &'static str,
    pub(super) by: Option<String>,
    pub(super) errors: Option<Vec<Vec<f64>>>,
}

impl Column {
    /// Mean error of an image.
    fn mean_px(&self, image: usize) -> Option<f64> {
        let errors = self.errors.as_ref()?.get(image)?;
        Some(errors.iter().sum::<f64>() / errors.len().max(1) as f64)
    }

    /// The row of an image.
    pub(super) fn row(&self, (image, name): (usize, &str), scores: &Scores) -> RebuiltRow {
        RebuiltRow {
            image: name.to_owned(),
            scheme: self.scheme.clone(),
            attack: self.attack,
            psnr: scores.psnr,
            ssim: scores.ssim,
            lpips: scores.lpips,
            feature_distance: scores.feature_distance,
            objects: scores.objects,
            objects_found: scores.objects_found,
            mean_px: self.mean_px(image),
        }
    }

    /// Means over its rows.
    pub(super) fn summary(&self, rows: &[RebuiltRow], beliefs: &PosePriors) -> SummaryRow {
        let mean =
            |of: &dyn Fn(&RebuiltRow) -> f64| rows.iter().map(of).sum::<f64>() / rows.len().max(1) as f64;
        let maybe = |of: fn(&RebuiltRow) -> Option<f64>| {
            let values: Option<Vec<f64>> = rows.iter().map(of).collect();
            values.filter(|v| !v.is_empty()).map(|v| v.iter().sum::<f64>() / v.len() as f64)
        };
        let sum = |of: fn(&RebuiltRow) -> Option<usize>| rows.iter().map(of).sum::<Option<usize>>();
        let mut all: Vec<f64> = self.errors.iter().flatten().flatten().copied().collect();
        all.sort_by(f64::total_cmp);
        SummaryRow {
            scheme: self.scheme.clone(),
            attack: self.attack,
            by: self.by.clone(),
            mean_px: maybe(|row| row.mean_px),
            median_px: all.get(all.len() / 2).copied(),
            psnr: mean(&|row| row.psnr),
            ssim: mean(&|row| row.ssim),
            lpips: maybe(|row| row.lpips),
            feature_distance: maybe(|row| row.feature_distance),
            objects: sum(|row| row.objects),
            objects_found: sum(|row| row.objects_found),
            told_apart: beliefs.told_apart(),
        }
    }
}

/// The means as a table for people.
pub fn evaluation_table(document: &EvaluationDocument) -> String {
    let head = [
        "scheme",
        "attack",
        "mean px",
        "median px",
        "PSNR dB",
        "SSIM",
        "LPIPS",
        "feature distance",
        "objects",
        "told apart",
    ];
    // Only where a network judges places.
    let columns = head.len() - usize::from(document.summary.iter().all(|row| row.told_apart.is_none()));
    let mut table = TextTable::new(head.into_iter().take(columns), 2);
    let maybe = |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
    for row in &document.summary {
        let by = row.by.as_ref().map_or_else(String::new, |by| format!(" ({by})"));
        let objects = row.objects_found.zip(row.objects);
        let mut cells = vec![
            row.scheme.clone(),
            format!("{}{by}", row.attack),
            maybe(row.mean_px, 1),
            maybe(row.median_px, 1),
            format!("{:.2}", row.psnr),
            format!("{:.3}", row.ssim),
            maybe(row.lpips, 3),
            maybe(row.feature_distance, 3),
            objects.map_or("-".to_owned(), |(found, all)| format!("{found} of {all}")),
            maybe(row.told_apart, 3),
        ];
        cells.truncate(columns);
        table.push(cells);
    }
    format!(
        "{}\nMeans over {} images on the networks' grids. Closed form and graph are told the true neighbours; nothing: a network \
         that is given no descriptor.\n",
        table.render(),
        document.images
    )
}
