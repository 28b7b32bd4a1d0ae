//! `veiloc train positions`.

use std::ops::ControlFlow;
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::learned::positions::{PositionNetwork, PositionTask, told, train};
use veiloc_attacks::learned::{Progress, TrainingOptions, TrainingState};
use veiloc_datasets::problem_files::{KeypointImage, seed_for};

use super::document::{OptionsRow, PositionCurveRow, PositionDocument, ToldRow};
use super::{ImageSets, all_known};

use crate::EvalError;

/// What to train on, and how.
#[derive(Debug, Clone)]
pub struct PositionRun {
    /// The images.
    pub sets: ImageSets,
    /// What is learned.
    pub task: PositionTask,
    /// The network and its training.
    pub options: TrainingOptions,
}

/// Trains; `observe` is called after every step, and may break off. `earlier` is a training that goes on.
///
/// # Errors
/// [`EvalError`] when a file cannot be read, an image is in two of the three sets, or training fails.
pub fn train_positions(
    run: &PositionRun,
    earlier: Option<TrainingState>,
    observe: impl FnMut(Progress<'_>) -> ControlFlow<()>,
) -> Result<(PositionNetwork, TrainingState, PositionDocument), EvalError> {
    let read = run.sets.read()?;
    let validation = all_known(&read.validate)?;
    let started = Instant::now();
    let trained = train(&read.train, &validation, &run.task, &run.options, earlier, observe)?;
    let seconds = started.elapsed().as_secs_f64();
    let mut rows = Vec::new();
    let mut judge = |part: &'static str, data: String, images: &[KeypointImage]| -> Result<(), EvalError> {
        // The same lines for every network, so that figures compare.
        let mut rng = ChaCha8Rng::seed_from_u64(seed_for(0, &[part, "positions told"]));
        let found = told(&trained.network, &all_known(images)?, &run.task, &mut rng)?;
        rows.extend(found.map(|told| ToldRow::new(part, data, images.len(), &told)));
        Ok(())
    };
    judge("validate", "all".to_owned(), &read.validate)?;
    for (name, images) in &read.test {
        judge("test", name.clone(), images)?;
    }
    let document = PositionDocument {
        version: 1,
        command: "train positions",
        scheme: run.task.scheme.to_string(),
        sees: run.task.sees.to_string(),
        crop: run.task.crop,
        mirror: run.task.mirror,
        images: read.counts(),
        keypoints: read.keypoints,
        options: OptionsRow::of(&run.options, None),
        parameters: trained.network.parameters(),
        best_step: trained.best_step,
        steps_done: trained.state.step(),
        seconds,
        curve: trained.curve.iter().map(PositionCurveRow::from).collect(),
        told: rows,
    };
    Ok((trained.network, trained.state, document))
}
