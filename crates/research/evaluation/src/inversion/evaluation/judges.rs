//! How alike an image is to the one it was made of, and which objects are still found in it.

use veiloc_attacks::image_metrics::{FeatureDistance, Lpips, psnr, ssim};
use veiloc_features::ColourImage;
use veiloc_features::detector::{Detection, Detector};

use crate::EvalError;

/// Boxes of one class that overlap by at least this are of one object.
const SAME: f32 = 0.5;

/// Who judges; PSNR and SSIM need nothing.
#[derive(Debug, Default)]
pub struct Judges {
    /// LPIPS, where its weights are at hand.
    pub lpips: Option<Lpips>,
    /// The distance of features, where its weights are at hand.
    pub feature_distance: Option<FeatureDistance>,
    /// The detector, and the least score that counts.
    pub detector: Option<(Detector, f32)>,
}

/// What they say; `None` where the judge is not there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scores {
    /// Peak signal-to-noise ratio, decibels.
    pub psnr: f64,
    /// Structural similarity, to 1.
    pub ssim: f64,
    /// LPIPS, from 0.
    pub lpips: Option<f64>,
    /// Distance of features, 0 to 1.
    pub feature_distance: Option<f64>,
    /// Objects in the original, on the same grid.
    pub objects: Option<usize>,
    /// Of those, how many are found again: same class, same place.
    pub objects_found: Option<usize>,
}

impl Judges {
    /// What is found in an image; nothing without a detector.
    pub(super) fn objects(&self, image: &ColourImage) -> Result<Vec<Detection>, EvalError> {
        match &self.detector {
            Some((detector, least)) => Ok(detector.detect(image, *least)?),
            None => Ok(Vec::new()),
        }
    }

    /// Judges an image beside the original of the same size, in which `objects` were found.
    pub(super) fn judge(
        &self,
        original: &ColourImage,
        objects: &[Detection],
        rebuilt: &ColourImage,
        seen: &[Detection],
    ) -> Result<Scores, EvalError> {
        let lpips = self.lpips.as_ref().map(|lpips| lpips.between(original, rebuilt)).transpose()?;
        let distance = self.feature_distance.as_ref().map(|d| d.between(original, rebuilt)).transpose()?;
        let detects = self.detector.is_some();
        Ok(Scores {
            psnr: psnr(original, rebuilt)?,
            ssim: ssim(original, rebuilt)?,
            lpips,
            feature_distance: distance,
            objects: detects.then_some(objects.len()),
            objects_found: detects.then(|| found(objects, seen)),
        })
    }
}

/// How many objects are among those seen; each of those counts once.
fn found(objects: &[Detection], seen: &[Detection]) -> usize {
    let mut left: Vec<&Detection> = seen.iter().collect();
    let mut count = 0;
    for object in objects {
        let overlap = |s: &&Detection| if s.class == object.class { s.overlap(object) } else { 0.0 };
        let best = (0..left.len()).max_by(|a, b| overlap(&left[*a]).total_cmp(&overlap(&left[*b])));
        if let Some(at) = best.filter(|at| overlap(&left[*at]) >= SAME) {
            left.remove(at);
            count += 1;
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(class: usize, left: f32) -> Detection {
        Detection { class, score: 0.5, corners: [left, 0.0, left + 10.0, 10.0] }
    }

    #[test]
    fn objects_are_found_by_class_and_place_and_once() {
        let objects = [at(0, 0.0), at(0, 1.0), at(1, 50.0)];
        assert_eq!(found(&objects, &objects), 3);
        assert_eq!(found(&objects, &[at(0, 0.5)]), 1, "one is not two");
        assert_eq!(found(&objects, &[at(0, 50.0), at(1, 0.0)]), 0, "of another class");
        assert_eq!(found(&objects, &[at(1, 53.0), at(0, 30.0)]), 1);
        assert_eq!(found(&[], &objects), 0);
    }
}
