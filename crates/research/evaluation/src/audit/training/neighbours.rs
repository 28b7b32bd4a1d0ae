//! `veiloc train neighbours`.

use std::ops::ControlFlow;
use std::time::Instant;

use veiloc_attacks::NeighbourPredictor;
use veiloc_attacks::learned::neighbours::{NeighbourNetwork, train};
use veiloc_attacks::learned::{Progress, TrainingOptions, TrainingState};
use veiloc_datasets::problem_files::KeypointImage;

use super::document::{CurveRow, OptionsRow, TrainingDocument};
use super::precision::{NEAREST, rows};
use super::{ImageSets, all_known};
use crate::EvalError;
use crate::audit::neighbours::Predictor;

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

/// Trains; `observe` is called after every step, and may break off. `earlier` is a training that goes on.
///
/// # Errors
/// [`EvalError`] when a file cannot be read, an image is in two of the three sets, or training fails.
pub fn train_neighbours(
    run: &NeighbourRun,
    earlier: Option<TrainingState>,
    observe: impl FnMut(Progress<'_>) -> ControlFlow<()>,
) -> Result<(NeighbourNetwork, TrainingState, TrainingDocument), EvalError> {
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
            let more = rows(part, set, predictor, name)?;
            // Of angles alone one row is enough.
            precision.extend(more.into_iter().filter(|r| name == "network" || r.predictor != "angles"));
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
