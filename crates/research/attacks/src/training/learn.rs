//! The training of any network: AdamW on images drawn at random, judged on images that are never learned from.
//!
//! Every step draws from a generator of its own, made of seed, step and image. So nothing of a generator is to be
//! remembered, images of a step are worked on side by side, and a training that was interrupted goes on as if it had
//! not been ([`TrainingState`]).

use std::ops::ControlFlow;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::AttackError;
use crate::training::course::Course;
use crate::training::optimizer::Memory;
use crate::training::schedule::learning_rate;
use crate::training::state::{Best, CurvePoint, TrainingState};

/// What is learned.
pub trait Subject: Sync {
    /// The loss of one image drawn by this generator, with its derivatives added to the `slopes`.
    fn lesson(&self, numbers: &[f32], slopes: &mut [f32], rng: &mut ChaCha8Rng) -> f64;

    /// How good a network is on the validation images: the greater the better.
    fn judge(&self, numbers: &[f32]) -> f64;
}

/// What an observer is shown after every step.
#[derive(Debug, Clone, Copy)]
pub struct Progress<'a> {
    /// Steps done.
    pub step: usize,
    /// The point of the curve, when there is one.
    pub point: Option<&'a CurvePoint>,
    /// From which the training can go on.
    pub state: &'a TrainingState,
}

/// What training gave.
#[derive(Debug, Clone)]
pub struct Trained<N> {
    /// The network of the best look at the validation images; the last one where there was no look.
    pub network: N,
    /// Steps done at that look.
    pub best_step: usize,
    /// All looks.
    pub curve: Vec<CurvePoint>,
    /// Where training stopped: at the last step, unless the observer broke off.
    pub state: TrainingState,
}

/// Trains from a state until all steps are done or the observer breaks off; returns the best numbers. `decays`: which numbers
/// are entries of matrices ([`Places::decaying`](crate::training::layers::Places::decaying)).
///
/// # Errors
/// [`AttackError::Diverged`] when loss or slopes are no numbers any more.
pub fn learn(
    subject: &impl Subject,
    decays: &[bool],
    options: &Course,
    mut state: TrainingState,
    mut observe: impl FnMut(Progress<'_>) -> ControlFlow<()>,
) -> Result<Trained<Vec<f32>>, AttackError> {
    while state.step < options.steps {
        let (loss, mut slopes) = slopes(subject, &state.numbers, options, state.step);
        if !loss.is_finite() || slopes.iter().any(|s| !s.is_finite()) {
            return Err(AttackError::Diverged { step: state.step });
        }
        let rate = learning_rate(options.learning_rate, state.step, options.steps);
        let how = (rate, options.weight_decay);
        state.memory.step(&mut state.numbers, &mut slopes, decays, how, state.step);
        state.losses += loss;
        state.since += 1;
        state.step += 1;

        let mut point = None;
        if state.step.is_multiple_of(options.validate_every) || state.step == options.steps {
            let judged = subject.judge(&state.numbers);
            let new = CurvePoint { step: state.step, loss: state.losses / state.since as f64, judged };
            (state.losses, state.since) = (0.0, 0);
            state.curve.push(new);
            if state.best.as_ref().is_none_or(|b| judged > b.judged) {
                state.best = Some(Best { judged, step: state.step, numbers: state.numbers.clone() });
            }
            point = Some(new);
        }
        let progress = Progress { step: state.step, point: point.as_ref(), state: &state };
        if observe(progress).is_break() {
            break;
        }
    }
    let (network, best_step) =
        state.best.as_ref().map_or((&state.numbers, state.step), |best| (&best.numbers, best.step));
    Ok(Trained { network: network.clone(), best_step, curve: state.curve.clone(), state })
}

/// Mean loss of the images of a step, and its derivatives.
fn slopes(subject: &impl Subject, numbers: &[f32], options: &Course, step: usize) -> (f64, Vec<f32>) {
    let of_image = |image: usize| {
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        // Stream 0 drew the first weights.
        rng.set_stream((step * options.images + image + 1) as u64);
        let mut slopes = vec![0.0; numbers.len()];
        (subject.lesson(numbers, &mut slopes, &mut rng), slopes)
    };
    let each: Vec<(f64, Vec<f32>)> = (0..options.images).into_par_iter().map(of_image).collect();
    // Summed in the order of the images, whatever the number of threads.
    let share = 1.0 / options.images as f32;
    let mut sum = vec![0.0; numbers.len()];
    let mut loss = 0.0;
    for (own, slopes) in &each {
        loss += own / options.images as f64;
        sum.iter_mut().zip(slopes).for_each(|(s, d)| *s += share * d);
    }
    (loss, sum)
}

/// What a first state begins with, and what a later one must have begun with.
///
/// # Errors
/// [`AttackError::OtherTraining`] when the earlier training was another one.
pub fn begin(
    numbers: Vec<f32>,
    fingerprint: u64,
    earlier: Option<TrainingState>,
) -> Result<TrainingState, AttackError> {
    match earlier {
        None => Ok(TrainingState {
            fingerprint,
            step: 0,
            memory: Memory::new(numbers.len()),
            numbers,
            best: None,
            curve: Vec::new(),
            losses: 0.0,
            since: 0,
        }),
        Some(state) if state.fingerprint == fingerprint && state.numbers.len() == numbers.len() => Ok(state),
        Some(_) => Err(AttackError::OtherTraining),
    }
}
