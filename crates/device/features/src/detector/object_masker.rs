//! Masks from the detections of a detector.

use std::io::Read;
use std::path::Path;

use crate::detector::{Detection, Detector};
use crate::{
    DisplayTurn, FeatureError, FrameMask, MAX_SEGMENTER_BYTES, Mask, PersonSegmenter, display_turn,
    load_colour,
};

/// The default margin of boxes.
const BOX_MARGIN: f32 = 0.15;

/// How much is hidden around a detection.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct HideOptions {
    /// Boxes are extended by this share of their width to the left and right, and of their height up and down; people of a
    /// segmenter by this share of the image. Default: 0.15 and [`FrameMask::MARGIN`]; boxes cut off hands, feet and hair.
    pub margin: Option<f32>,
    /// Minimum score of hidden detections. Default 0.2: hiding a wrong detection costs a few keypoints, but a missed
    /// person would be revealed.
    pub least_score: f32,
}

impl Default for HideOptions {
    fn default() -> Self {
        Self { margin: None, least_score: 0.2 }
    }
}

/// A detector with the classes to hide.
#[derive(Debug)]
pub struct ObjectMasker {
    finder: Finder,
    options: HideOptions,
}

#[derive(Debug)]
enum Finder {
    /// Boxes, and whether each class is hidden.
    Boxes(Detector, Vec<bool>),
    People(PersonSegmenter),
}

/// The hidden part of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Hidden {
    /// Names and numbers of the detected classes, in the order of the detector's classes. Of a segmenter, the number of
    /// regions with people, which may be 0.
    pub found: Vec<(String, usize)>,
    /// The mask; `None` when nothing was detected.
    pub mask: Option<Mask>,
}

impl ObjectMasker {
    /// Opens a detector file, with the names of the classes to hide: boxes as [`Detector`] has them, or a network for
    /// [`PersonSegmenter`], whose one class is `people`.
    ///
    /// # Errors
    /// As [`Detector::open`]; [`FeatureError::UnknownClass`] and [`FeatureError::NoClass`].
    pub fn open(path: &Path, classes: &[String], options: HideOptions) -> Result<Self, FeatureError> {
        let (finder, names) = if let Some(segmenter) = segmenter(path)? {
            (Finder::People(segmenter), vec![PersonSegmenter::CLASS.to_owned()])
        } else {
            let detector = Detector::open(path)?;
            let names = detector.names().to_vec();
            let hides = names.iter().map(|name| classes.contains(name)).collect();
            (Finder::Boxes(detector, hides), names)
        };
        if classes.is_empty() {
            return Err(FeatureError::NoClass { known: names.join(", ") });
        }
        if let Some(unknown) = classes.iter().find(|class| !names.contains(class)) {
            return Err(FeatureError::UnknownClass { requested: unknown.clone(), known: names.join(", ") });
        }
        Ok(Self { finder, options })
    }

    /// The mask of an image file. The detector sees the image as it is displayed, and the mask is of the stored pixels.
    ///
    /// # Errors
    /// [`FeatureError`]: the image cannot be read, the detector failed, or the detections cover the whole image.
    pub fn hide(&self, image: &Path) -> Result<Hidden, FeatureError> {
        let turns = display_turn(image).map(DisplayTurn::turns).unwrap_or_default();
        let image = load_colour(image)?;
        let (detector, hides) = match &self.finder {
            Finder::Boxes(detector, hides) => (detector, hides),
            Finder::People(segmenter) => {
                let mask = segmenter.mask(&image, turns, self.options.margin.unwrap_or(FrameMask::MARGIN))?;
                let regions = mask.as_ref().map_or(0, Mask::regions);
                return Ok(Hidden { found: vec![(PersonSegmenter::CLASS.to_owned(), regions)], mask });
            }
        };
        let image = image.turned(turns);
        // All boxes are hidden without suppression: where they differ, the right one is unknown.
        let mut all = detector.candidates(&image, self.options.least_score)?;
        all.retain(|detection| hides[detection.class]);
        let mask = mask_of(&all, self.options.margin.unwrap_or(BOX_MARGIN), [image.width(), image.height()])?;
        let things = crate::detector::boxes::suppress_overlaps(all, 0.5);
        let names = detector.names().iter().enumerate();
        let count = |class: usize| things.iter().filter(|thing| thing.class == class).count();
        let found = names.map(|(class, name)| (name.clone(), count(class))).filter(|(_, n)| *n > 0).collect();
        Ok(Hidden { found, mask: mask.map(|mask| mask.turned(turns.inverse())) })
    }
}

/// The segmenter of a TFLite file; `None` for another file.
fn segmenter(path: &Path) -> Result<Option<PersonSegmenter>, FeatureError> {
    let read = |source| FeatureError::ReadDetector { path: path.to_owned(), source };
    let mut bytes = Vec::new();
    // One byte more than allowed is enough to see that a file is too large.
    let mut file = std::fs::File::open(path).map_err(read)?.take(MAX_SEGMENTER_BYTES + 1);
    file.read_to_end(&mut bytes).map_err(read)?;
    if !PersonSegmenter::is_tflite(&bytes) {
        return Ok(None);
    }
    PersonSegmenter::read(&bytes).map(Some).map_err(|error| match error {
        FeatureError::Segmenter { reason } => FeatureError::Detector { path: path.to_owned(), reason },
        other => other,
    })
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
