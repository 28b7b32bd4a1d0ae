//! The training: images drawn at random, judged by PSNR on images that are never learned from.

use std::ops::ControlFlow;

use crate::EvalError;
use crate::inversion::example::{Example, Lesson};
use crate::inversion::inverter::Inverter;
use crate::inversion::loss::loss_of;
use crate::inversion::network::Network;
use crate::inversion::task::InversionTask;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use veiloc_attacks::training::{
    Course, Progress, Subject, Trained, TrainingState, begin, fingerprint, learn,
};

/// Trains a network, and keeps that of the highest PSNR on the `validation` images.
///
/// `earlier` is an interrupted training of the same task, course and images, which goes on. `observe` is called after every
/// step, and may break off. The validation images should be of other places than the `training` images, and what is said
/// about an unseen place must be measured on a third one, as the step was chosen on these.
///
/// # Errors
/// [`EvalError::Nothing`] where there is nothing to learn from or to judge by, [`EvalError::Obfuscate`] when an image
/// cannot be obfuscated, and those of [`veiloc_attacks::AttackError`].
pub fn train(
    training: &[Example],
    validation: &[Example],
    task: &InversionTask,
    course: &Course,
    earlier: Option<TrainingState>,
    observe: impl FnMut(Progress<'_>) -> ControlFlow<()>,
) -> Result<Trained<Inverter>, EvalError> {
    task.shape.check()?;
    course.check()?;
    let lessons: Vec<&Example> = training.iter().filter(|example| !example.is_empty()).collect();
    if lessons.is_empty() {
        return Err(EvalError::Nothing("learn from"));
    }
    // The same every time, whatever the seed, so that curves compare.
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let judged = validation.iter().filter(|example| !example.is_empty());
    let judged: Vec<Lesson> =
        judged.map(|example| example.whole(task, &mut rng)).collect::<Result<_, _>>()?;
    if judged.is_empty() {
        return Err(EvalError::Nothing("choose the best step by"));
    }
    let (net, places) = Network::new(task.shape);
    let numbers = places.draw(&mut ChaCha8Rng::seed_from_u64(course.seed));
    let begun_with = fingerprint(|feed| {
        feed(format!("inversion {task:?} {course:?}").as_bytes());
        for set in [training, validation] {
            feed(&(set.len() as u64).to_le_bytes());
            for example in set {
                example.feed(feed);
            }
        }
    });
    let state = begin(numbers, begun_with, earlier)?;
    let subject = Inversion { net: net.clone(), lessons, judged, task };
    let trained = learn(&subject, &places.decaying(), course, state, observe)?;
    Ok(Trained {
        network: Inverter::new(net, trained.network, task.scheme),
        best_step: trained.best_step,
        curve: trained.curve,
        state: trained.state,
    })
}

struct Inversion<'a> {
    net: Network,
    lessons: Vec<&'a Example>,
    judged: Vec<Lesson>,
    task: &'a InversionTask,
}

impl Subject for Inversion<'_> {
    fn lesson(&self, numbers: &[f32], slopes: &mut [f32], rng: &mut ChaCha8Rng) -> f64 {
        let example = self.lessons[rng.random_range(0..self.lessons.len())];
        // Keypoints lie in the image, so that every scheme takes them.
        let Ok(Lesson { placed, right, truth }) = example.draw(self.task, rng) else { return f64::NAN };
        let (made, tape) = self.net.forward(numbers, &placed);
        let (loss, of_made) = loss_of(&made, &placed, &right, &truth);
        self.net.backward(numbers, slopes, &placed, &tape, &of_made);
        loss
    }

    /// Mean PSNR, decibels.
    fn judge(&self, numbers: &[f32]) -> f64 {
        let of = |lesson: &Lesson| {
            let colours = self.net.forward(numbers, &lesson.placed).0.colours;
            let pairs = colours.iter().zip(lesson.truth.iter());
            let squares: f64 = pairs.map(|(c, t)| f64::from(c.clamp(0.0, 1.0) - t).powi(2)).sum();
            -10.0 * (squares / colours.len() as f64).max(1e-12).log10()
        };
        let each: Vec<f64> = self.judged.par_iter().map(of).collect();
        each.iter().sum::<f64>() / each.len() as f64
    }
}
