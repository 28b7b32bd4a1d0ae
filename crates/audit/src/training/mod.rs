//! `veiloc train neighbours`: a network is trained on some places, chosen on a second, and judged on a third.
//!
//! What is said about unseen places comes from the images of [`TrainingRun::test`] alone: those of
//! [`TrainingRun::validate`] chose the step that is kept.

mod document;

use std::path::PathBuf;
use std::time::Instant;

pub use veiloc_attacks::network::TrainingOptions;
use veiloc_attacks::network::{CurvePoint, NeighbourNetwork, train};
use veiloc_attacks::{KnownImage, NeighbourLists, NeighbourPredictor};

use super::neighbours::{Predictor, known};
use crate::error::AuditError;
use veiloc_datasets::{KeypointImage, read_keypoints};

pub use document::{CurveRow, OptionsRow, PrecisionRow, TrainingDocument, training_table};

/// What to train on, and how.
#[derive(Debug, Clone)]
pub struct TrainingRun {
    /// Files of keypoints with descriptors that are learned from.
    pub train: Vec<PathBuf>,
    /// Files of another place, by which the best step is chosen.
    pub validate: Vec<PathBuf>,
    /// Files of a third place, which only the final figures are of; may be empty.
    pub test: Vec<PathBuf>,
    /// At most so many validation images, evenly picked.
    pub validation_images: usize,
    /// The network and its training.
    pub options: TrainingOptions,
}

/// Neighbours a keypoint that the final figures count, of the 20 nearest.
const LENGTHS: [usize; 3] = [5, 10, 20];
const NEAREST: usize = 20;

/// Trains; `observe` is called after every step with the steps done, and with the point of the curve when there is one.
///
/// # Errors
/// [`AuditError`] when a file cannot be read, an image is in two of the three sets, or training fails.
pub fn train_neighbours(
    run: &TrainingRun,
    observe: impl FnMut(usize, Option<&CurvePoint>),
) -> Result<(NeighbourNetwork, TrainingDocument), AuditError> {
    let (train_set, test_set) = (read_all(&run.train)?, read_all(&run.test)?);
    let validation_set = spread(read_all(&run.validate)?, run.validation_images);
    refuse_shared(&[("--train", &train_set), ("--validate", &validation_set), ("--test", &test_set)])?;
    let all_known = |set: &[KeypointImage]| set.iter().map(known).collect::<Result<Vec<_>, _>>();
    let (training, validation) = (all_known(&train_set)?, all_known(&validation_set)?);

    let started = Instant::now();
    let trained = train(&training, &validation, &run.options, observe)?;
    let seconds = started.elapsed().as_secs_f64();
    let statistic = NeighbourPredictor::fit(&training, NEAREST)?;
    let network = Predictor::Network(Box::new(trained.network.clone()));
    let statistic = Predictor::Statistic(statistic);
    let mut precision = Vec::new();
    for (part, set) in [("validate", &validation_set), ("test", &test_set)] {
        for (predictor, name) in [(&network, "network"), (&statistic, "statistic")] {
            precision.extend(row(part, set, predictor, name)?);
        }
    }
    let document = TrainingDocument {
        version: 1,
        command: "train neighbours",
        images: [training.len(), validation.len(), test_set.len()],
        keypoints: train_set.iter().map(|p| p.keypoints.len()).sum(),
        options: (&run.options).into(),
        parameters: trained.network.parameters(),
        best_step: trained.best_step,
        seconds,
        curve: trained.curve.iter().map(CurveRow::from).collect(),
        precision,
    };
    Ok((trained.network, document))
}

fn read_all(files: &[PathBuf]) -> Result<Vec<KeypointImage>, AuditError> {
    let read: Vec<_> = files.iter().map(|f| read_keypoints(f)).collect::<Result<_, _>>()?;
    Ok(read.concat())
}

/// At most so many, from the first to the last.
fn spread(images: Vec<KeypointImage>, most: usize) -> Vec<KeypointImage> {
    let all = images.len();
    let most = most.clamp(1, all.max(1));
    let kept: Vec<usize> = (0..most).map(|i| i * all / most).collect();
    images.into_iter().enumerate().filter(|(i, _)| kept.contains(i)).map(|(_, p)| p).collect()
}

/// A figure of an image that was learned from would be worth nothing.
fn refuse_shared(sets: &[(&str, &Vec<KeypointImage>)]) -> Result<(), AuditError> {
    for (i, (a, first)) in sets.iter().enumerate() {
        for (b, second) in &sets[i + 1..] {
            let same = |x: &KeypointImage, y: &KeypointImage| x.name == y.name && x.keypoints == y.keypoints;
            if let Some(shared) = first.iter().find(|x| second.iter().any(|y| same(x, y))) {
                return Err(AuditError::Options(format!(
                    "{} is among the images of {a} and of {b}; give images of different places",
                    shared.name
                )));
            }
        }
    }
    Ok(())
}

/// Precision over all keypoints of some images; `None` without any.
fn row(
    part: &'static str,
    set: &[KeypointImage],
    predictor: &Predictor,
    name: &'static str,
) -> Result<Option<PrecisionRow>, AuditError> {
    let (mut right, mut said_of, mut chance, mut keypoints) = ([0usize; 3], [0usize; 3], 0.0, 0usize);
    for image in set {
        let known: KnownImage = known(image)?;
        let said = predictor.predict(known.descriptors(), NEAREST)?;
        let near = NeighbourLists::nearest(&image.keypoints, NEAREST);
        for i in 0..near.len() {
            let is_near = |j: &&u32| near.of(i).contains(j);
            for (slot, length) in LENGTHS.into_iter().enumerate() {
                let first = &said.of(i)[..length.min(said.of(i).len())];
                right[slot] += first.iter().filter(is_near).count();
                said_of[slot] += first.len();
            }
            chance += near.of(i).len() as f64 / (near.len() as f64 - 1.0).max(1.0);
        }
        keypoints += near.len();
    }
    let share = |slot: usize| right[slot] as f64 / said_of[slot] as f64;
    Ok((keypoints > 0 && said_of[0] > 0).then(|| PrecisionRow {
        part,
        predictor: name,
        images: set.len(),
        at_5: share(0),
        at_10: share(1),
        at_20: share(2),
        chance: chance / keypoints as f64,
    }))
}
