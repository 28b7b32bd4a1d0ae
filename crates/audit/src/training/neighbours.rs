//! `veiloc train neighbours`.

use std::ops::ControlFlow;
use std::time::Instant;

use veiloc_attacks::{KnownImage, NeighbourLists, NeighbourPredictor};
use veiloc_datasets::KeypointImage;
use veiloc_outsider::neighbours::{NeighbourNetwork, train};
use veiloc_outsider::{Progress, TrainingOptions, TrainingState};

use super::document::{CurveRow, OptionsRow, PrecisionRow, TrainingDocument};
use super::{ImageSets, all_known};
use crate::error::AuditError;
use crate::neighbours::{Predictor, known};

/// What to train on, and how.
#[derive(Debug, Clone)]
pub struct NeighbourRun {
    /// The images.
    pub sets: ImageSets,
    /// Nearest keypoints of an image that count as neighbours.
    pub neighbours: usize,
    /// The network and its training.
    pub options: TrainingOptions,
}

/// Neighbours a keypoint that the final figures count, of the 20 nearest.
const LENGTHS: [usize; 3] = [5, 10, 20];
const NEAREST: usize = 20;

/// Trains; `observe` is called after every step, and may break off. `earlier` is a training that goes on.
///
/// # Errors
/// [`AuditError`] when a file cannot be read, an image is in two of the three sets, or training fails.
pub fn train_neighbours(
    run: &NeighbourRun,
    earlier: Option<TrainingState>,
    observe: impl FnMut(Progress<'_>) -> ControlFlow<()>,
) -> Result<(NeighbourNetwork, TrainingState, TrainingDocument), AuditError> {
    let read = run.sets.read()?;
    let validation = all_known(&read.validate)?;
    let started = Instant::now();
    let trained = train(&read.train, &validation, run.neighbours, &run.options, earlier, observe)?;
    let seconds = started.elapsed().as_secs_f64();
    let network = Predictor::Network(Box::new(trained.network.clone()));
    let statistic = Predictor::Statistic(NeighbourPredictor::fit(&read.train, NEAREST)?);
    let test: Vec<KeypointImage> = read.test.iter().flat_map(|(_, images)| images.clone()).collect();
    let mut precision = Vec::new();
    for (part, set) in [("validate", &read.validate), ("test", &test)] {
        for (predictor, name) in [(&network, "network"), (&statistic, "statistic")] {
            precision.extend(row(part, set, predictor, name)?);
        }
    }
    let document = TrainingDocument {
        version: 1,
        command: "train neighbours",
        images: read.counts(),
        keypoints: read.keypoints,
        options: OptionsRow::of(&run.options, Some(run.neighbours)),
        parameters: trained.network.parameters(),
        best_step: trained.best_step,
        steps_done: trained.state.step(),
        seconds,
        curve: trained.curve.iter().map(CurveRow::from).collect(),
        precision,
    };
    Ok((trained.network, trained.state, document))
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
