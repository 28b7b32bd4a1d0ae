//! Image metrics: similarity of a reconstruction to its original, and objects and classes that are still recognised.

use veiloc_attacks::image_metrics::{Classifier, PerceptualDistance, psnr, ssim};
use veiloc_features::ColourImage;
use veiloc_features::detector::{Detection, Detector};

use crate::EvalError;

/// Boxes of one class that overlap at least this much belong to one object.
const MIN_OVERLAP: f32 = 0.5;

/// Networks of the image metrics; PSNR and SSIM need none.
#[derive(Debug, Default)]
pub struct ImageMetrics {
    /// ST-LPIPS.
    pub perceptual: Option<PerceptualDistance>,
    /// ImageNet classifier.
    pub classifier: Option<Classifier>,
    /// The detector, and the smallest accepted score.
    pub detector: Option<(Detector, f32)>,
}

/// Values of the metrics; `None` without the network.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReconstructionScores {
    /// Peak signal-to-noise ratio, decibels.
    pub psnr: f64,
    /// Structural similarity, at most 1.
    pub ssim: f64,
    /// Peak signal-to-noise ratio in the box around the keypoints that a server does not know, decibels; `None` without a
    /// server.
    pub private_psnr: Option<f64>,
    /// ST-LPIPS, at least 0.
    pub st_lpips: Option<f64>,
    /// Whether the image's class is the likeliest, and whether it is among the five likeliest.
    pub recognised: Option<[bool; 2]>,
    /// Objects in the original, on the same grid.
    pub objects: Option<usize>,
    /// Number of those that are detected again: same class, same position.
    pub objects_found: Option<usize>,
}

impl ImageMetrics {
    /// Detected objects; empty without a detector.
    pub(super) fn objects(&self, image: &ColourImage) -> Result<Vec<Detection>, EvalError> {
        match &self.detector {
            Some((detector, least)) => Ok(detector.detect(image, *least)?),
            None => Ok(Vec::new()),
        }
    }

    /// An original on the grid, with its detected objects and its class: that of its file name, or else the
    /// classifier's answer.
    pub(super) fn prepare(&self, image: ColourImage, named: Option<usize>) -> Result<Original, EvalError> {
        let objects = self.objects(&image)?;
        let mut class = None;
        if let Some(classifier) = &self.classifier {
            let classes = classifier.classes(&image)?;
            class = named.or(classes.first().copied()).map(|class| Class {
                number: class,
                is_named: named.is_some(),
                recognised: recognised(class, &classes),
            });
        }
        Ok(Original { image, objects, class })
    }

    /// Compares an image with its original on the same grid.
    pub(super) fn compare(
        &self,
        original: &Original,
        rebuilt: &ColourImage,
        seen: &[Detection],
    ) -> Result<ReconstructionScores, EvalError> {
        let Original { image: original, objects, class } = original;
        let st_lpips = self.perceptual.as_ref().map(|p| p.between(original, rebuilt)).transpose()?;
        let classes = self.classifier.as_ref().map(|c| c.classes(rebuilt)).transpose()?;
        let detects = self.detector.is_some();
        Ok(ReconstructionScores {
            psnr: psnr(original, rebuilt)?,
            ssim: ssim(original, rebuilt)?,
            private_psnr: None,
            st_lpips,
            recognised: class.as_ref().zip(classes).map(|(class, found)| recognised(class.number, &found)),
            objects: detects.then_some(objects.len()),
            objects_found: detects.then(|| found(objects, seen)),
        })
    }
}

/// An original on the grid, with its contents.
#[derive(Debug, Clone)]
pub(super) struct Original {
    pub(super) image: ColourImage,
    pub(super) objects: Vec<Detection>,
    /// Set if there is a classifier.
    pub(super) class: Option<Class>,
}

/// The class of an original.
#[derive(Debug, Clone, Copy)]
pub(super) struct Class {
    number: usize,
    /// Whether the class comes from the file name.
    pub(super) is_named: bool,
    /// Whether the classifier recognises the original itself: first, and among five.
    pub(super) recognised: [bool; 2],
}

/// Whether a class is the first of the five likeliest, and whether it is one of them.
fn recognised(class: usize, likeliest: &[usize]) -> [bool; 2] {
    [likeliest.first() == Some(&class), likeliest.contains(&class)]
}

/// Number of objects that are among the detected ones; each detection counts once.
fn found(objects: &[Detection], seen: &[Detection]) -> usize {
    let mut left: Vec<&Detection> = seen.iter().collect();
    let mut count = 0;
    for object in objects {
        let overlap = |s: &&Detection| if s.class == object.class { s.overlap(object) } else { 0.0 };
        let best = (0..left.len()).max_by(|a, b| overlap(&left[*a]).total_cmp(&overlap(&left[*b])));
        if let Some(at) = best.filter(|at| overlap(&left[*at]) >= MIN_OVERLAP) {
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
    fn top_1_and_top_5_are_counted() {
        let found = [7, 3, 9, 1, 4];
        assert_eq!(recognised(7, &found), [true, true]);
        assert_eq!(recognised(4, &found), [false, true]);
        assert_eq!(recognised(5, &found), [false, false]);
    }

    #[test]
    fn objects_are_matched_once_by_class_and_position() {
        let objects = [at(0, 0.0), at(0, 1.0), at(1, 50.0)];
        assert_eq!(found(&objects, &objects), 3);
        assert_eq!(found(&objects, &[at(0, 0.5)]), 1, "one is not two");
        assert_eq!(found(&objects, &[at(0, 50.0), at(1, 0.0)]), 0, "of another class");
        assert_eq!(found(&objects, &[at(1, 53.0), at(0, 30.0)]), 1);
        assert_eq!(found(&[], &objects), 0);
    }
}
