//! From a network's scores to keypoints: local maxima, the strongest first.

use crate::FeatureError;
use crate::learned::Tensor;
use crate::learned::description::{Refine, ScoreForm, Scores};
use crate::learned::prepare::Placement;

/// One score for each pixel of the network's input.
#[derive(Clone, PartialEq)]
pub(crate) struct ScoreMap {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// `[height, width]`
    pub(crate) data: Vec<f32>,
}

/// A keypoint in the network's input.
#[derive(Clone, Copy, PartialEq)]
pub(crate) struct Peak {
    /// Integers are the centres of pixels.
    pub(crate) position: [f64; 2],
    /// The pixel of its maximum.
    pub(crate) pixel: [usize; 2],
    pub(crate) score: f32,
}

impl ScoreMap {
    /// From the network's output.
    ///
    /// # Errors
    /// [`FeatureError::NetworkRun`] when the layers do not match the description, or contain NaN or infinity.
    pub(crate) fn of(scores: Tensor, described: &Scores) -> Result<Self, FeatureError> {
        let broken = |reason: &str| FeatureError::NetworkRun { reason: format!("its scores {reason}") };
        let scores = if described.channels_last { scores.channels_first() } else { Some(scores) };
        let scores = scores.ok_or_else(|| broken("are not an image"))?;
        let [channels, rows, columns] = scores.image().ok_or_else(|| broken("are not an image"))?;
        if scores.data.iter().any(|number| !number.is_finite()) {
            return Err(broken("contain NaN or infinity"));
        }
        match described.form {
            ScoreForm::Map if channels == 1 => Ok(Self { width: columns, height: rows, data: scores.data }),
            ScoreForm::Map => Err(broken("are not one per pixel")),
            ScoreForm::Cells if channels == described.stride.pow(2) + 1 => {
                Ok(Self::of_cells(&scores.data, [rows, columns], described.stride))
            }
            ScoreForm::Cells => Err(broken("are not one per pixel of a cell plus one for no keypoint")),
        }
    }

    /// The softmax over the positions of each cell and "none", as an image.
    fn of_cells(logits: &[f32], [rows, columns]: [usize; 2], stride: usize) -> Self {
        let (width, height, cells) = (columns * stride, rows * stride, rows * columns);
        let mut data = vec![0.0; width * height];
        let mut shares = vec![0.0; stride * stride + 1];
        for cell in 0..cells {
            let of_cell = logits.iter().skip(cell).step_by(cells);
            let most = of_cell.clone().fold(f32::NEG_INFINITY, |most, logit| most.max(*logit));
            for (share, logit) in shares.iter_mut().zip(of_cell) {
                *share = (logit - most).exp();
            }
            let sum: f32 = shares.iter().sum();
            for (position, share) in shares[..stride * stride].iter().enumerate() {
                let y = cell / columns * stride + position / stride;
                data[y * width + cell % columns * stride + position % stride] = share / sum;
            }
        }
        Self { width, height, data }
    }

    /// The peaks of the image, strongest first; of equal ones first the upper, then the left.
    ///
    /// `factor`: the factor on the score of a peak, by its pixel.
    pub(crate) fn peaks(
        &self,
        described: &Scores,
        placement: Placement,
        factor: impl Fn([usize; 2]) -> f32,
        most: usize,
    ) -> Vec<Peak> {
        let kept = self.suppressed(described.radius, described.rounds);
        let mut peaks = Vec::new();
        for (at, score) in self.data.iter().enumerate() {
            let pixel = [at % self.width, at / self.width];
            if kept[at] && *score > described.threshold && placement.inside(pixel, described.border) {
                peaks.push(Peak { position: [0.0; 2], pixel, score: score * factor(pixel) });
            }
        }
        // A stable sort: equal ones stay in row order.
        peaks.sort_by(|a, b| b.score.total_cmp(&a.score));
        peaks.truncate(most);
        for peak in &mut peaks {
            peak.position = self.refined(peak.pixel, described);
        }
        peaks
    }

    /// The pixels that are maxima within `radius`; each further round adds maxima after pixels near a peak are removed
    /// (`simple_nms` of SuperGlue's and ALIKE's programs).
    fn suppressed(&self, radius: usize, rounds: usize) -> Vec<bool> {
        let largest = |data: &[f32]| self.largest(data, radius);
        let mut kept: Vec<bool> =
            self.data.iter().zip(largest(&self.data)).map(|(own, most)| *own == most).collect();
        for _ in 0..rounds {
            let marks: Vec<f32> = kept.iter().map(|kept| f32::from(u8::from(*kept))).collect();
            let near: Vec<bool> = largest(&marks).into_iter().map(|mark| mark > 0.0).collect();
            let rest: Vec<f32> =
                self.data.iter().zip(&near).map(|(s, near)| if *near { 0.0 } else { *s }).collect();
            for (((kept, own), most), near) in kept.iter_mut().zip(&rest).zip(largest(&rest)).zip(&near) {
                *kept |= *own == most && !near;
            }
        }
        kept
    }

    /// The maximum within `radius` pixels of each pixel, along both axes.
    fn largest(&self, data: &[f32], radius: usize) -> Vec<f32> {
        let (width, height) = (self.width, self.height);
        let mut across = data.to_vec();
        for (row, out) in data.chunks_exact(width).zip(across.chunks_exact_mut(width)) {
            for shift in 1..=radius.min(width.saturating_sub(1)) {
                for (out, other) in out.iter_mut().zip(&row[shift..]) {
                    *out = out.max(*other);
                }
                for (out, other) in out[shift..].iter_mut().zip(row) {
                    *out = out.max(*other);
                }
            }
        }
        let mut both = across.clone();
        for (y, out) in both.chunks_exact_mut(width).enumerate() {
            for other in y.saturating_sub(radius)..(y + radius + 1).min(height) {
                for (out, other) in out.iter_mut().zip(&across[other * width..][..width]) {
                    *out = out.max(*other);
                }
            }
        }
        both
    }

    fn score(&self, x: isize, y: isize) -> f32 {
        let inside = |at: isize, side: usize| (0..side as isize).contains(&at);
        if inside(x, self.width) && inside(y, self.height) {
            self.data[y as usize * self.width + x as usize]
        } else {
            0.0
        }
    }

    /// The position of a peak, with subpixel refinement if described.
    fn refined(&self, [x, y]: [usize; 2], described: &Scores) -> [f64; 2] {
        let (column, row) = (x as isize, y as isize);
        let [dx, dy] = match described.refine {
            Refine::None => [0.0; 2],
            Refine::Parabola => {
                let peak = |before: f32, own: f32, behind: f32| {
                    let curve = f64::from(before) - 2.0 * f64::from(own) + f64::from(behind);
                    let slope = (f64::from(before) - f64::from(behind)) / 2.0;
                    if curve < 0.0 { (slope / curve).clamp(-0.5, 0.5) } else { 0.0 }
                };
                let own = self.score(column, row);
                [
                    peak(self.score(column - 1, row), own, self.score(column + 1, row)),
                    peak(self.score(column, row - 1), own, self.score(column, row + 1)),
                ]
            }
            Refine::Mean => {
                // Differentiable keypoint detection of ALIKE, section III-B; its temperature is 0.1.
                let reach = described.radius as isize;
                let most = self.score(column, row);
                let (mut sum, mut mean) = (0.0, [0.0; 2]);
                for dy in -reach..=reach {
                    for dx in -reach..=reach {
                        let weight =
                            f64::from((self.score(column + dx, row + dy) - most) / TEMPERATURE).exp();
                        sum += weight;
                        mean = [mean[0] + weight * dx as f64, mean[1] + weight * dy as f64];
                    }
                }
                mean.map(|offset| offset / sum)
            }
        };
        [x as f64 + dx, y as f64 + dy]
    }
}

const TEMPERATURE: f32 = 0.1;
