//! Columns of the table: one input of the network each.

use veiloc_attacks::learned::inversion::{Grid, InversionNetwork, PositionKnowledge, Reconstruction};
use veiloc_attacks::{DecodedDescriptors, Observation};
use veiloc_datasets::problem_files::KeypointImage;
use veiloc_geometry::Pixel;
use veiloc_geometry::statistics::upper_median;

use super::document::{ReconstructionRow, SummaryRow};
use super::image_metrics::ReconstructionScores;
use super::recovered::RecoveredImage;
use super::visibility::VisibilityScores;
use crate::EvalError;

/// One input of the network with its results.
pub(super) struct Column {
    scheme: String,
    attack: &'static str,
    /// Name of the best realistic attack.
    by: Option<String>,
    input: Input,
    /// By image.
    pub(super) rows: Vec<ReconstructionRow>,
    visibility: VisibilityScores,
}

pub(super) enum Input {
    /// Positions, by image.
    Positions(Vec<RecoveredImage>),
    /// The positions that the server knows, by image; the others are left out.
    Known(Vec<RecoveredImage>),
    /// The sent observations, by image.
    Lines(Vec<RecoveredImage>),
    Unordered,
    None,
}

impl Column {
    pub(super) fn new(scheme: &str, attack: &'static str, by: Option<String>, input: Input) -> Self {
        let scheme = scheme.to_owned();
        Self { scheme, attack, by, input, rows: Vec::new(), visibility: VisibilityScores::default() }
    }

    /// Name on a contact sheet.
    pub(super) fn name(&self) -> String {
        format!("{} {}", self.scheme, self.attack)
    }

    /// The positions that the network gets, by image.
    pub(super) fn positions(&self) -> Option<&[RecoveredImage]> {
        if let Input::Positions(answers) = &self.input { Some(answers) } else { None }
    }

    /// The cells of the box around the keypoints that a server does not know: left, upper, right and lower end; `None`
    /// without a server, and where the box has no cell.
    pub(super) fn private_cells(&self, at: usize, image: &KeypointImage, grid: Grid) -> Option<[usize; 4]> {
        let (Input::Positions(answers) | Input::Known(answers)) = &self.input else { return None };
        let answer = &answers[at];
        if answer.measured.iter().all(|measured| *measured) {
            return None;
        }
        let own = image.keypoints.iter().zip(&answer.measured).filter(|(_, measured)| **measured);
        let cells = own.map(|(p, _)| {
            let along = |x: f64, pixels: u32, cells: usize| {
                ((x / f64::from(pixels) * cells as f64).max(0.0) as usize).min(cells - 1)
            };
            [along(p.u, image.width, grid.width), along(p.v, image.height, grid.height)]
        });
        cells.fold(None, |corners, [x, y]| {
            let [left, upper, right, lower] = corners.unwrap_or([x, y, x + 1, y + 1]);
            Some([left.min(x), upper.min(y), right.max(x + 1), lower.max(y + 1)])
        })
    }

    /// The network's output for an image; `times`: side of the view relative to the image.
    pub(super) fn reconstruct(
        &self,
        network: &InversionNetwork,
        at: usize,
        image: &KeypointImage,
        descriptors: &DecodedDescriptors,
        times: u32,
    ) -> Result<Reconstruction, EvalError> {
        let size = [image.width, image.height];
        let known = match &self.input {
            Input::Positions(answers) => PositionKnowledge::Positions(&answers[at].positions),
            Input::Known(answers) => {
                // What has no position is in no cell.
                let known = answers[at].sent.iter().map(|sent| match sent {
                    Observation::Known(position) => *position,
                    _ => Pixel::new(f64::NAN, f64::NAN),
                });
                let known: Vec<Pixel> = known.collect();
                return Ok(network.invert(descriptors, size, PositionKnowledge::Positions(&known), times)?);
            }
            Input::Lines(answers) => PositionKnowledge::Lines(&answers[at].sent),
            Input::Unordered => PositionKnowledge::None,
            Input::None => {
                let none = DecodedDescriptors::as_they_are(descriptors.dimension(), 0, std::iter::empty());
                return Ok(network.invert(&none, size, PositionKnowledge::Positions(&[]), times)?);
            }
        };
        Ok(network.invert(descriptors, size, known, times)?)
    }

    /// Adds the next image. `visibility`: the network's output; `cell`: side of a cell, pixels.
    pub(super) fn add(
        &mut self,
        image: &str,
        scores: &ReconstructionScores,
        visibility: Option<&[f32]>,
        cell: f64,
    ) {
        let answer = self.positions().map(|answers| &answers[self.rows.len()]);
        let errors = answer.map(|answer| answer.measured().collect::<Vec<f64>>());
        let all = answer.map(|answer| answer.errors.clone());
        if let (Some(visibility), Some(errors)) = (visibility, &all) {
            self.visibility.add(visibility, errors, cell);
        }
        self.rows.push(ReconstructionRow {
            image: image.to_owned(),
            scheme: self.scheme.clone(),
            attack: self.attack,
            psnr: scores.psnr,
            ssim: scores.ssim,
            private_psnr: scores.private_psnr,
            st_lpips: scores.st_lpips,
            top_1: scores.recognised.map(|[first, _]| first),
            top_5: scores.recognised.map(|[_, five]| five),
            objects: scores.objects,
            objects_found: scores.objects_found,
            mean_px: errors.map(|errors| errors.iter().sum::<f64>() / errors.len().max(1) as f64),
        });
    }

    /// Means over its rows.
    pub(super) fn summary(&self) -> SummaryRow {
        let rows = &self.rows;
        let mean = |of: &dyn Fn(&ReconstructionRow) -> f64| {
            rows.iter().map(of).sum::<f64>() / rows.len().max(1) as f64
        };
        let maybe = |of: fn(&ReconstructionRow) -> Option<f64>| {
            let values: Option<Vec<f64>> = rows.iter().map(of).collect();
            values.filter(|v| !v.is_empty()).map(|v| v.iter().sum::<f64>() / v.len() as f64)
        };
        let sum = |of: fn(&ReconstructionRow) -> Option<usize>| rows.iter().map(of).sum::<Option<usize>>();
        let mut errors: Vec<f64> =
            self.positions().into_iter().flatten().flat_map(RecoveredImage::measured).collect();
        SummaryRow {
            scheme: self.scheme.clone(),
            attack: self.attack,
            best_attack: self.by.clone(),
            mean_px: maybe(|row| row.mean_px),
            median_px: upper_median(&mut errors),
            psnr: mean(&|row| row.psnr),
            ssim: mean(&|row| row.ssim),
            private_psnr: maybe(|row| row.private_psnr),
            st_lpips: maybe(|row| row.st_lpips),
            top_1: sum(|row| row.top_1.map(usize::from)),
            top_5: sum(|row| row.top_5.map(usize::from)),
            objects: sum(|row| row.objects),
            objects_found: sum(|row| row.objects_found),
            roc_auc: self.visibility.roc_auc(),
        }
    }
}
