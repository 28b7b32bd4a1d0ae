//! Results of an evaluation: the stable JSON document and the text table.

use crate::results::text_table::TextTable;
use serde::Serialize;
use veiloc_attacks::learned::inversion::InversionNetwork;

use super::image_metrics::{Class, ReconstructionScores};
use super::visibility::VisibilityScores;

/// The document that `veiloc eval inversion --json` writes.
#[derive(Debug, Clone, Serialize)]
pub struct InversionDocument {
    /// Version of this document; a field is never removed or given another meaning under the same number.
    pub version: u32,
    /// `eval inversion`.
    pub command: &'static str,
    /// Images.
    pub images: usize,
    /// Neighbours per keypoint that attacks are given.
    pub k: usize,
    /// Seed of obfuscation and attacks.
    pub seed: u64,
    /// The network.
    pub network: NetworkRow,
    /// Classification of the originals; `null` without a classifier.
    pub classes: Option<ClassesRow>,
    /// Means over images.
    pub summary: Vec<SummaryRow>,
    /// One for each image, scheme and attack.
    pub rows: Vec<ReconstructionRow>,
}

/// A network.
#[derive(Debug, Clone, Serialize)]
pub struct NetworkRow {
    /// The file of its description.
    pub file: String,
    /// Descriptor kind of its training data.
    pub features: String,
    /// Descriptor length.
    pub dimension: usize,
    /// Cells along the longer side of an image.
    pub side: usize,
    /// Whether the network estimates which positions are correct.
    pub judges_places: bool,
}

impl From<&InversionNetwork> for NetworkRow {
    fn from(network: &InversionNetwork) -> Self {
        Self {
            file: network.file().display().to_string(),
            features: network.features().to_owned(),
            dimension: network.dimension(),
            side: network.side(),
            judges_places: network.has_visibility(),
        }
    }
}

/// Results of the classifier on the originals, on the network's grid.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct ClassesRow {
    /// Images whose class is given by the name of their file or folder, as an ImageNet synset.
    pub named: usize,
    /// Of those, how many originals the classifier gets right.
    pub named_top_1: usize,
    /// Of those, how many originals have the right class among the five likeliest.
    pub named_top_5: usize,
    /// Images without a given class: the classifier's answer on the original counts as the class.
    pub answered: usize,
}

impl ClassesRow {
    /// Counts an original.
    pub(super) fn add(&mut self, class: &Class) {
        if class.is_named {
            self.named += 1;
            self.named_top_1 += usize::from(class.recognised[0]);
            self.named_top_5 += usize::from(class.recognised[1]);
        } else {
            self.answered += 1;
        }
    }

    /// In a sentence.
    pub fn sentence(&self) -> String {
        let Self { named, named_top_1, named_top_5, answered } = self;
        format!(
            "Classes: {named} images are named by their ImageNet synset; the classifier recognises {named_top_1} of these \
             originals (top-1) and {named_top_5} (top-5). For {answered} other images the class is the classifier's own \
             answer on the original."
        )
    }
}

/// An image reconstructed from an image's descriptors, and its similarity to that image.
#[derive(Debug, Clone, Serialize)]
pub struct ReconstructionRow {
    /// The image.
    pub image: String,
    /// The scheme under which it was sent; `bag` for descriptors alone, `nothing` for no descriptors.
    pub scheme: String,
    /// `none` if nothing has to be recovered, `guess` for the prior-only baseline, `closed-form` and `graph` with
    /// true neighbours, `realistic`, or `lines` if each descriptor is spread over its line.
    pub attack: &'static str,
    /// Peak signal-to-noise ratio, decibels.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// ST-LPIPS; `null` without its network.
    pub st_lpips: Option<f64>,
    /// Whether the image's class is the classifier's first answer; `null` without a classifier.
    pub top_1: Option<bool>,
    /// Whether it is among the five likeliest.
    pub top_5: Option<bool>,
    /// Objects found in the original; `null` without a detector.
    pub objects: Option<usize>,
    /// Number of those that are found in the reconstruction.
    pub objects_found: Option<usize>,
    /// Mean error of the positions given to the network, pixels; `null` if it was given none.
    pub mean_px: Option<f64>,
}

/// Means over images.
#[derive(Debug, Clone, Serialize)]
pub struct SummaryRow {
    /// As in [`ReconstructionRow`].
    pub scheme: String,
    /// As in [`ReconstructionRow`].
    pub attack: &'static str,
    /// Name of the best realistic attack.
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
    pub st_lpips: Option<f64>,
    /// Number of images whose class is the likeliest.
    pub top_1: Option<usize>,
    /// Number of images whose class is among the five likeliest.
    pub top_5: Option<usize>,
    /// Sum of the rows.
    pub objects: Option<usize>,
    /// Sum of the rows.
    pub objects_found: Option<usize>,
    /// ROC AUC of the network's visibility output: probability that a correctly placed keypoint has a larger value
    /// than a wrong one, 0.5 by chance; `null` if the network has no such output, or all keypoints are right or
    /// wrong.
    pub told_apart: Option<f64>,
}

/// One input of the network: its name in rows, and position errors by image, `[images][N]`.
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
    pub(super) fn row(
        &self,
        (image, name): (usize, &str),
        scores: &ReconstructionScores,
    ) -> ReconstructionRow {
        ReconstructionRow {
            image: name.to_owned(),
            scheme: self.scheme.clone(),
            attack: self.attack,
            psnr: scores.psnr,
            ssim: scores.ssim,
            st_lpips: scores.st_lpips,
            top_1: scores.recognised.map(|[first, _]| first),
            top_5: scores.recognised.map(|[_, five]| five),
            objects: scores.objects,
            objects_found: scores.objects_found,
            mean_px: self.mean_px(image),
        }
    }

    /// Means over its rows.
    pub(super) fn summary(&self, rows: &[ReconstructionRow], scores: &VisibilityScores) -> SummaryRow {
        let mean = |of: &dyn Fn(&ReconstructionRow) -> f64| {
            rows.iter().map(of).sum::<f64>() / rows.len().max(1) as f64
        };
        let maybe = |of: fn(&ReconstructionRow) -> Option<f64>| {
            let values: Option<Vec<f64>> = rows.iter().map(of).collect();
            values.filter(|v| !v.is_empty()).map(|v| v.iter().sum::<f64>() / v.len() as f64)
        };
        let sum = |of: fn(&ReconstructionRow) -> Option<usize>| rows.iter().map(of).sum::<Option<usize>>();
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
            st_lpips: maybe(|row| row.st_lpips),
            top_1: sum(|row| row.top_1.map(usize::from)),
            top_5: sum(|row| row.top_5.map(usize::from)),
            objects: sum(|row| row.objects),
            objects_found: sum(|row| row.objects_found),
            told_apart: scores.roc_auc(),
        }
    }
}

/// The means as a text table.
pub fn evaluation_table(document: &InversionDocument) -> String {
    let head = [
        "scheme",
        "attack",
        "mean px",
        "median px",
        "PSNR dB",
        "SSIM",
        "ST-LPIPS",
        "objects",
        "top-1",
        "top-5",
        "ROC AUC",
    ];
    // Only if a network estimates visibility.
    let columns = head.len() - usize::from(document.summary.iter().all(|row| row.told_apart.is_none()));
    let mut table = TextTable::new(head.into_iter().take(columns), 2);
    let count = |value: Option<usize>| value.map_or("-".to_owned(), |v| v.to_string());
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
            maybe(row.st_lpips, 3),
            objects.map_or("-".to_owned(), |(found, all)| format!("{found} of {all}")),
            count(row.top_1),
            count(row.top_5),
            maybe(row.told_apart, 3),
        ];
        cells.truncate(columns);
        table.push(cells);
    }
    let classes = document.classes.map_or_else(String::new, |classes| classes.sentence() + "\n");
    format!(
        "{}\n{classes}Means over {} images on the network's grid. Closed form and graph use true neighbours; nothing: the \
         network gets no descriptors.\n",
        table.render(),
        document.images
    )
}
