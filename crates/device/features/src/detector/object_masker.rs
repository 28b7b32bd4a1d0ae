//! Masks from the detections of a detector.

use std::path::Path;

use crate::{FeatureError, Mask, load_colour};

use crate::detector::{Detection, Detector};

/// How much is hidden around a detection.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct HideOptions {
    /// Boxes are extended by this share of their width to the left and right, and of their height up and down. Default
    /// 0.15: a detector's boxes cut off hands, feet and hair.
    pub margin: f32,
    /// Minimum score of hidden detections. Default 0.2: hiding a wrong detection costs a few keypoints, but a missed
    /// person would be revealed.
    pub least_score: f32,
}

impl Default for HideOptions {
    fn default() -> Self {
        Self { margin: 0.15, least_score: 0.2 }
    }
}

/// A detector with the classes to hide.
#[derive(Debug)]
pub struct ObjectMasker {
    detector: Detector,
    /// `[classes]`: whether each is hidden.
    hides: Vec<bool>,
    options: HideOptions,
}

/// The hidden part of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Hidden {
    /// Names and numbers of the detected classes, in the order of the detector's classes.
    pub found: Vec<(String, usize)>,
    /// The mask; `None` when nothing was detected.
    pub mask: Option<Mask>,
}

impl ObjectMasker {
    /// Opens a detector file, with the names of the classes to hide.
    ///
    /// # Errors
    /// As [`Detector::open`]; [`FeatureError::UnknownClass`] and [`FeatureError::NoClass`].
    pub fn open(path: &Path, classes: &[String], options: HideOptions) -> Result<Self, FeatureError> {
        let detector = Detector::open(path)?;
        let known = || detector.names().join(", ");
        if classes.is_empty() {
            return Err(FeatureError::NoClass { known: known() });
        }
        let mut hides = vec![false; detector.names().len()];
        for requested in classes {
            let at = detector.names().iter().position(|name| name == requested);
            let at = at
                .ok_or_else(|| FeatureError::UnknownClass { requested: requested.clone(), known: known() })?;
            hides[at] = true;
        }
        Ok(Self { detector, hides, options })
    }

    /// The mask of an image file.
    ///
    /// # Errors
    /// [`FeatureError`]: the image cannot be read, the detector failed, or the detections cover the whole image.
    pub fn hide(&self, image: &Path) -> Result<Hidden, FeatureError> {
        let image = load_colour(image)?;
        // All boxes are hidden without suppression: where they differ, the right one is unknown.
        let mut all = self.detector.candidates(&image, self.options.least_score)?;
        all.retain(|detection| self.hides[detection.class]);
        let mask = mask_of(&all, self.options.margin, [image.width(), image.height()])?;
        let things = crate::detector::boxes::suppress_overlaps(all, 0.5);
        let names = self.detector.names().iter().enumerate();
        let count = |class: usize| things.iter().filter(|thing| thing.class == class).count();
        let found = names.map(|(class, name)| (name.clone(), count(class))).filter(|(_, n)| *n > 0).collect();
        Ok(Hidden { found, mask })
    }
}

/// The pixels of all boxes with their margin; `None` when no box lies in the image.
fn mask_of(all: &[Detection], margin: f32, [width, height]: [u32; 2]) -> Result<Option<Mask>, FeatureError> {
    let widened: Vec<[f32; 4]> = all
        .iter()
        .map(|detection| {
            let [left, upper, right, lower] = detection.corners;
            let (across, down) = (margin * (right - left), margin * (lower - upper));
            [left - across, upper - down, right + across, lower + down]
        })
        .collect();
    // A pixel is hidden when any part of it is.
    let hides = |x: u32, y: u32| {
        let (x, y) = (x as f32, y as f32);
        widened.iter().any(|[left, upper, right, lower]| {
            *left < x + 1.0 && *right > x && *upper < y + 1.0 && *lower > y
        })
    };
    match Mask::new(width, height, hides) {
        Ok(mask) => Ok(Some(mask)),
        Err(FeatureError::HidesNothing { .. }) => Ok(None),
        Err(other) => Err(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(corners: [f32; 4]) -> Detection {
        Detection { class: 0, score: 0.9, corners }
    }

    #[test]
    fn boxes_are_hidden_with_a_margin() {
        let mask = mask_of(&[at([20.0, 10.0, 40.0, 50.0])], 0.1, [100, 80]).expect("a part").expect("found");
        for (x, y, hidden) in [
            (17, 30, false),
            (18, 30, true),
            (41, 30, true),
            (42, 30, false),
            (30, 5, false),
            (30, 6, true),
            (30, 54, false),
        ] {
            assert_eq!(mask.hides(x, y), hidden, "{x} {y}");
        }
        assert!((mask.share() - 24.0 * 48.0 / 8000.0).abs() < 1e-12);
        // Two different boxes of one object are both hidden.
        let both = [at([20.0, 10.0, 40.0, 50.0]), at([24.0, 10.0, 44.0, 50.0])];
        assert!(mask_of(&both, 0.0, [100, 80]).expect("a part").expect("found").hides(43, 30));
        // Nothing detected, nothing in the image, the whole image.
        assert_eq!(mask_of(&[], 0.1, [100, 80]).expect("nothing"), None);
        assert_eq!(mask_of(&[at([200.0, 0.0, 210.0, 10.0])], 0.1, [100, 80]).expect("nothing"), None);
        let all = mask_of(&[at([1.0, 1.0, 99.0, 79.0])], 0.1, [100, 80]);
        assert!(matches!(all, Err(FeatureError::HidesAll { .. })));
    }
}
