//! The training: the cross entropy of the bin in which a keypoint is, on images obfuscated anew at every draw.

use std::ops::ControlFlow;

use crate::training::{Progress, Subject, Trained, TrainingState, begin, learn};
use crate::{AttackError, KnownImage};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::bins::Bins;
use super::lessons::{Drawn, Lesson};
use super::told::information;
use super::{Layers, PositionNetwork, PositionTask, mirror};
use crate::learned::engine::Matrix;
use crate::learned::engine::dropout::Dropout;
use crate::learned::engine::exponential::softmax;
use crate::learned::neighbours::one_dimension;
use crate::learned::options::{TrainingOptions, refuse};

/// Bins of a row in training. Answers are smooth, so that finer ones teach nothing more.
const BINS: usize = 64;

/// Trains a network, and keeps that which tells most about the `validation` images.
///
/// `earlier` is an interrupted training of the same task, options and images, which goes on. `observe` is called after
/// every step, and may break off. The validation images should be of other places than the `training` images, and what
/// is said about an unseen place must be measured on a third one, as the step was chosen on these.
///
/// # Errors
/// [`AttackError::Option`] for options that make no sense, an [`AttackError`] when there is nothing to learn or
/// judge, or descriptors differ in dimension, [`AttackError::Seal`] when an image cannot be obfuscated,
/// [`AttackError::Diverged`] when the loss is no number any more, [`AttackError::OtherTraining`] when the earlier
/// training was another one.
pub fn train(
    training: &[KnownImage],
    validation: &[KnownImage],
    task: &PositionTask,
    options: &TrainingOptions,
    earlier: Option<TrainingState>,
    observe: impl FnMut(Progress<'_>) -> ControlFlow<()>,
) -> Result<Trained<PositionNetwork>, AttackError> {
    let dimension = one_dimension(training, validation)?;
    options.check()?;
    if task.mirror && dimension != mirror::DIMENSION {
        let allowed = "128, that of SIFT, where images are mirrored";
        return Err(refuse("descriptor dimension", dimension, allowed));
    }
    let (layers, places) = Layers::of_options(dimension, task.sees, options)?;
    let lessons: Vec<Lesson> = training.iter().filter_map(Lesson::new).collect();
    let judged: Vec<Lesson> = validation.iter().filter_map(Lesson::new).collect();
    if lessons.is_empty() || judged.is_empty() {
        return Err(AttackError::NothingToLearn);
    }
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let mut numbers = places.draw(&mut rng);
    // Before it has learned anything the network says the guess.
    numbers[layers.encoder.last_weights()].fill(0.0);
    // The same every time, whatever the seed, so that curves compare.
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let judged: Vec<Drawn> = judged.iter().map(|l| l.whole(task, &mut rng)).collect::<Result<_, _>>()?;
    let judged = judged.into_iter().map(|drawn| {
        let (bins, truth) = drawn.bins(BINS);
        (drawn, bins, truth)
    });
    let what = format!("positions {task:?}");
    let state = begin(numbers, options.fingerprint(&what, [training, validation]), earlier)?;
    let subject = Positions { layers: layers.clone(), lessons, judged: judged.collect(), task, options };
    let trained = learn(&subject, &places.decaying(), &options.course(), state, observe)?;
    Ok(Trained {
        network: PositionNetwork { layers, numbers: trained.network, scheme: task.scheme },
        best_step: trained.best_step,
        curve: trained.curve,
        state: trained.state,
    })
}

struct Positions<'a> {
    layers: Layers,
    lessons: Vec<Lesson>,
    /// With the bins of every row, and the one in which its keypoint is.
    judged: Vec<(Drawn, Bins, Vec<Option<usize>>)>,
    task: &'a PositionTask,
    options: &'a TrainingOptions,
}

impl Subject for Positions<'_> {
    fn lesson(&self, numbers: &[f32], slopes: &mut [f32], rng: &mut ChaCha8Rng) -> f64 {
        let lesson = &self.lessons[rng.random_range(0..self.lessons.len())];
        // Keypoints lie in the image, so that every scheme takes them.
        let Ok(drawn) = lesson.draw(self.task, self.options.keypoints, rng) else { return f64::NAN };
        let mut dropout = Dropout::new(self.options.dropout, rng);
        loss(&self.layers, numbers, &drawn, &mut dropout, slopes)
    }

    fn judge(&self, numbers: &[f32]) -> f64 {
        let (mut bits, mut rows) = (0.0, 0.0);
        for (drawn, bins, truth) in &self.judged {
            let shares = self.layers.shares(numbers, &drawn.descriptors, bins, drawn.size);
            let (own, counted) = information(&shares, bins, truth);
            bits += own;
            rows += counted as f64;
        }
        if rows > 0.0 { bits / rows } else { 0.0 }
    }
}

/// Mean over the rows, with its derivatives added to the `slopes`.
fn loss(
    layers: &Layers,
    numbers: &[f32],
    drawn: &Drawn,
    dropout: &mut Dropout<'_>,
    slopes: &mut [f32],
) -> f64 {
    let (bins, truth) = drawn.bins(BINS);
    let rows = truth.iter().flatten().count();
    if rows == 0 {
        return 0.0;
    }
    let at_bins = layers.at_bins(&bins, drawn.size);
    let input = layers.input(&drawn.descriptors, &bins, &at_bins, drawn.size);
    let (answers, tape) = layers.encoder.forward(numbers, &input, dropout);
    let mut shares = Layers::logits(&answers, &bins, &at_bins);
    let mut of_answers = Matrix::zeros(answers.nrows(), answers.ncols());
    let mut loss = 0.0;
    for (row, truth) in truth.iter().enumerate() {
        let Some(truth) = truth else { continue };
        let own = bins.of_row(row);
        let logit = shares[*truth];
        let sum = softmax(&mut shares[own.clone()]);
        loss += f64::from(sum - logit);
        let mut slope = of_answers.column_mut(row);
        for bin in own {
            let along = (shares[bin] - f32::from(u8::from(bin == *truth))) / rows as f32;
            slope.axpy(along, &at_bins.column(bin), 1.0);
        }
    }
    layers.encoder.backward(numbers, slopes, &input, &tape, &of_answers);
    loss / rows as f64
}

#[cfg(test)]
mod tests {
    use crate::Descriptors;
    use veiloc_geometry::Pixel;

    use super::super::Sees;
    use super::*;

    /// The gradient that training follows, against differences of the loss.
    #[test]
    fn the_gradient_is_that_of_the_loss() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let keypoints: Vec<Pixel> =
            (0..30).map(|_| Pixel::new(rng.random_range(0.0..320.0), rng.random_range(0.0..240.0))).collect();
        let bytes: Vec<u8> = (0..30 * 6).map(|_| rng.random()).collect();
        let descriptors = Descriptors::new(&bytes, 6).expect("whole");
        let image = KnownImage::new(keypoints, descriptors, 320, 240).expect("one each");
        let task = PositionTask::new("dcl".parse().expect("a scheme")).expect("it hides");
        let drawn = Lesson::new(&image).expect("inside").draw(&task, 20, &mut rng).expect("sent");
        let (layers, places) = Layers::new(6, Sees::Set, [8, 2, 2]).expect("small");
        let numbers: Vec<f32> =
            places.draw(&mut rng).iter().map(|v| v + rng.random_range(-0.05..0.05)).collect();
        let of = |numbers: &[f32]| {
            let mut slopes = vec![0.0; numbers.len()];
            let value = loss(&layers, numbers, &drawn, &mut Dropout::none(), &mut slopes);
            (value, slopes)
        };
        let (_, slopes) = of(&numbers);
        for _ in 0..8 {
            let along: Vec<f32> = numbers.iter().map(|_| rng.random_range(-1.0..1.0)).collect();
            let at = |t: f32| of(&numbers.iter().zip(&along).map(|(v, a)| v + t * a).collect::<Vec<_>>()).0;
            let h = 1e-3;
            let measured = (at(h) - at(-h)) / f64::from(2.0 * h);
            let told: f64 = slopes.iter().zip(&along).map(|(s, a)| f64::from(*s) * f64::from(*a)).sum();
            assert!((measured - told).abs() < 0.03 * told.abs().max(0.5), "{measured} {told}");
        }
    }
}
