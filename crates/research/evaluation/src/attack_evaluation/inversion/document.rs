//! Results of an evaluation: the stable JSON document and the text table.

use crate::results::text_table::TextTable;
use serde::Serialize;
use veiloc_attacks::learned::inversion::InversionNetwork;

use super::image_metrics::Class;

/// Images that a network reconstructs from descriptors and positions, compared with the originals.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct InversionDocument {
    /// Version of this document.
    pub version: u32,
    /// `eval inversion`.
    pub command: &'static str,
    /// Number of images.
    pub images: usize,
    /// True neighbours per keypoint that attacks are given.
    pub k: usize,
    /// Seed of obfuscation and attacks.
    pub seed: u64,
    /// The network.
    pub network: NetworkRow,
    /// Classification of the originals; `null` without a classifier.
    pub classes: Option<ClassesRow>,
    /// Means over images, one entry per scheme and attack.
    pub summary: Vec<SummaryRow>,
    /// One entry per image, scheme and attack.
    pub rows: Vec<ReconstructionRow>,
}

/// A network.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
    pub has_visibility: bool,
}

impl From<&InversionNetwork> for NetworkRow {
    fn from(network: &InversionNetwork) -> Self {
        Self {
            file: network.file().display().to_string(),
            features: network.features().to_owned(),
            dimension: network.dimension(),
            side: network.side(),
            has_visibility: network.has_visibility(),
        }
    }
}

/// Results of the classifier on the originals, on the network's grid.
#[derive(Debug, Clone, Copy, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ClassesRow {
    /// Number of images whose class is given by the name of their file or folder, as an ImageNet synset.
    pub labelled: usize,
    /// Number of those whose original the classifier gets right.
    pub labelled_top_1: usize,
    /// Number of those whose original has the right class among the five likeliest.
    pub labelled_top_5: usize,
    /// Number of images without a given class: the classifier's answer on the original is taken as their class.
    pub pseudo_labelled: usize,
}

impl ClassesRow {
    /// Counts an original.
    pub(super) fn add(&mut self, class: &Class) {
        if class.is_named {
            self.labelled += 1;
            self.labelled_top_1 += usize::from(class.recognised[0]);
            self.labelled_top_5 += usize::from(class.recognised[1]);
        } else {
            self.pseudo_labelled += 1;
        }
    }

    /// In a sentence.
    pub fn sentence(&self) -> String {
        let Self { labelled, labelled_top_1, labelled_top_5, pseudo_labelled } = self;
        format!(
            "Classes: {labelled} images are named by their ImageNet synset; the classifier recognises {labelled_top_1} of these \
             originals (top-1) and {labelled_top_5} (top-5). For {pseudo_labelled} other images the class is the classifier's own \
             answer on the original."
        )
    }
}

/// An image reconstructed from an image's descriptors, and its similarity to that image.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ReconstructionRow {
    /// Name of the image.
    pub image: String,
    /// The scheme under which it was sent; `unordered` for descriptors alone, `none` for no descriptors.
    pub scheme: String,
    /// `none` if nothing has to be recovered, `prior` for the prior-only baseline, `closed-form` and `graph` with
    /// true neighbours, `realistic`, or `lines` if each descriptor is spread over its line; of a server that knows the
    /// pose `matched` (only what matches its map), `server-side`, `iterative` and `occlusion`.
    pub attack: &'static str,
    /// Peak signal-to-noise ratio on the network's grid, decibels.
    pub psnr: f64,
    /// Structural similarity, at most 1.
    pub ssim: f64,
    /// Peak signal-to-noise ratio in the box around the keypoints that a server does not know; absent without a server.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub private_psnr: Option<f64>,
    /// ST-LPIPS; `null` without its network.
    pub st_lpips: Option<f64>,
    /// Whether the image's class is the classifier's first answer; `null` without a classifier.
    pub top_1: Option<bool>,
    /// Whether it is among the five likeliest; `null` without a classifier.
    pub top_5: Option<bool>,
    /// Objects found in the original; `null` without a detector.
    pub objects: Option<usize>,
    /// Number of those that are found in the reconstruction: same class, boxes with an overlap of at least half; `null`
    /// without a detector.
    pub objects_found: Option<usize>,
    /// Mean error of the positions given to the network, pixels, of a server's attacks of those that it does not know;
    /// `null` if it was given none.
    pub mean_px: Option<f64>,
}

/// Means over images.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SummaryRow {
    /// As in `rows`.
    pub scheme: String,
    /// As in `rows`.
    pub attack: &'static str,
    /// Name of the best realistic attack; absent for other attacks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub best_attack: Option<String>,
    /// Mean error of the positions, over images, pixels; `null` without positions.
    pub mean_px: Option<f64>,
    /// Median over all keypoints of all images, pixels; `null` without positions.
    pub median_px: Option<f64>,
    /// Mean over images, decibels.
    pub psnr: f64,
    /// Mean over images.
    pub ssim: f64,
    /// Mean over images; absent without a server.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub private_psnr: Option<f64>,
    /// Mean over images; `null` without its network.
    pub st_lpips: Option<f64>,
    /// Number of images whose class is the classifier's first answer; `null` without a classifier.
    pub top_1: Option<usize>,
    /// Number of images whose class is among the five likeliest; `null` without a classifier.
    pub top_5: Option<usize>,
    /// Sum over images; `null` without a detector.
    pub objects: Option<usize>,
    /// Sum over images; `null` without a detector.
    pub objects_found: Option<usize>,
    /// ROC AUC of the network's visibility output: probability that a correctly placed keypoint has a larger value
    /// than a wrong one, 0.5 by chance; `null` if the network has no such output, or all keypoints are right or
    /// wrong.
    pub roc_auc: Option<f64>,
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
        "private dB",
        "ROC AUC",
    ];
    // The last two only with a server, and if a network estimates visibility.
    let any = |of: fn(&SummaryRow) -> Option<f64>| document.summary.iter().any(|row| of(row).is_some());
    let is_shown =
        [vec![true; head.len() - 2], vec![any(|row| row.private_psnr), any(|row| row.roc_auc)]].concat();
    let shown = |cells: Vec<String>| {
        cells
            .into_iter()
            .zip(&is_shown)
            .filter(|(_, shown)| **shown)
            .map(|(cell, _)| cell)
            .collect::<Vec<_>>()
    };
    let mut table = TextTable::new(shown(head.map(str::to_owned).to_vec()), 2);
    let count = |value: Option<usize>| value.map_or("-".to_owned(), |v| v.to_string());
    let maybe = |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
    for row in &document.summary {
        let by = row.best_attack.as_ref().map_or_else(String::new, |by| format!(" ({by})"));
        let objects = row.objects_found.zip(row.objects);
        let cells = vec![
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
            maybe(row.private_psnr, 2),
            maybe(row.roc_auc, 3),
        ];
        table.push(shown(cells));
    }
    let classes = document.classes.map_or_else(String::new, |classes| classes.sentence() + "\n");
    format!(
        "{}\n{classes}Means over {} images on the network's grid. Closed form and graph use true neighbours; nothing: the \
         network gets no descriptors.\n",
        table.render(),
        document.images
    )
}
