//! `veiloc train`: a network is trained on some places, chosen on a second, and judged on a third.
//!
//! What is said about unseen places comes from the images of [`ImageSets::test`] alone: those of
//! [`ImageSets::validate`] chose the step that is kept. An image in two of the sets is refused.

mod document;
mod neighbours;
mod positions;
mod precision;

use std::collections::BTreeMap;
use std::path::PathBuf;

pub use veiloc_attacks::learned::positions::{PositionNetwork, PositionTask, Sees};
pub use veiloc_attacks::learned::{CurvePoint, Progress, TrainingOptions, TrainingState};

use crate::EvalError;
use crate::audit::neighbours::known;
use veiloc_attacks::KnownImage;
use veiloc_datasets::problem_files::{KeypointImage, json_lines, read_keypoints};

pub use document::{
    CurveRow, OptionsRow, PositionCurveRow, PositionDocument, PrecisionRow, ToldRow, TrainingDocument,
    position_table, training_table,
};
pub use neighbours::{NeighbourRun, train_neighbours};
pub use positions::{PositionRun, train_positions};

/// Files of keypoints with descriptors, by what they are for.
#[derive(Debug, Clone, Default)]
pub struct ImageSets {
    /// Files that are learned from.
    pub train: Vec<PathBuf>,
    /// Files of another place, by which the best step is chosen.
    pub validate: Vec<PathBuf>,
    /// Files of a third place, which only the final figures are of; may be empty.
    pub test: Vec<PathBuf>,
    /// At most so many validation images, evenly picked.
    pub validation_images: usize,
}

/// The images of [`ImageSets`].
struct Read {
    train: Vec<KnownImage>,
    validate: Vec<KeypointImage>,
    /// By file, with its name.
    test: Vec<(String, Vec<KeypointImage>)>,
    keypoints: usize,
}

impl ImageSets {
    fn read(&self) -> Result<Read, EvalError> {
        let files = |files: &[PathBuf]| {
            let read = |file: &PathBuf| Ok((json_lines::display_name(file), read_keypoints(file)?));
            files.iter().map(read).collect::<Result<Vec<(String, Vec<KeypointImage>)>, EvalError>>()
        };
        let together = |files: Vec<(String, Vec<KeypointImage>)>| -> Vec<KeypointImage> {
            files.into_iter().flat_map(|(_, images)| images).collect()
        };
        let train = together(files(&self.train)?);
        let validate = spread(together(files(&self.validate)?), self.validation_images);
        let test = files(&self.test)?;
        let tested: Vec<&KeypointImage> = test.iter().flat_map(|(_, images)| images).collect();
        let (learned, chosen) = (train.iter().collect(), validate.iter().collect());
        refuse_shared(&[("--train", learned), ("--validate", chosen), ("--test", tested)])?;
        let keypoints = train.iter().map(|p| p.keypoints.len()).sum();
        Ok(Read { train: all_known(&train)?, validate, test, keypoints })
    }
}

impl Read {
    fn counts(&self) -> [usize; 3] {
        [self.train.len(), self.validate.len(), self.test.iter().map(|(_, images)| images.len()).sum()]
    }
}

fn all_known(images: &[KeypointImage]) -> Result<Vec<KnownImage>, EvalError> {
    images.iter().map(known).collect()
}

/// At most so many, from the first to the last.
fn spread(images: Vec<KeypointImage>, most: usize) -> Vec<KeypointImage> {
    let all = images.len();
    let most = most.clamp(1, all.max(1));
    let kept: Vec<usize> = (0..most).map(|i| i * all / most).collect();
    images.into_iter().enumerate().filter(|(i, _)| kept.contains(i)).map(|(_, p)| p).collect()
}

/// A figure of an image that was learned from would be worth nothing. Images are told by their keypoints, whatever they
/// are called.
fn refuse_shared(sets: &[(&str, Vec<&KeypointImage>)]) -> Result<(), EvalError> {
    let bits = |image: &KeypointImage| -> Vec<[u64; 2]> {
        image.keypoints.iter().map(|p| [p.u.to_bits(), p.v.to_bits()]).collect()
    };
    let mut seen: BTreeMap<Vec<[u64; 2]>, usize> = BTreeMap::new();
    for (set, (own, images)) in sets.iter().enumerate() {
        for image in images.iter().filter(|image| !image.keypoints.is_empty()) {
            let first = *seen.entry(bits(image)).or_insert(set);
            if first != set {
                return Err(EvalError::Options(format!(
                    "{} is among the images of {} and of {own}; give images of different places",
                    image.name, sets[first].0
                )));
            }
        }
    }
    Ok(())
}
