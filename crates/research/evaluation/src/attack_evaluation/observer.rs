//! Observer of an evaluation: sent observations, answers and errors, image by image.
//!
//! The document holds summaries; a report that draws images needs the single keypoints and gets them from here.

use veiloc_attacks::{NeighbourLists, Observation};
use veiloc_geometry::Pixel;
use veiloc_protocol::{Observations, Scheme};

use super::attacks::Attack;
use veiloc_datasets::problem_files::KeypointImage;

/// Images of one group: for each image, the others train the learned prior and are the map of `transfer`.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageGroup {
    /// Name in the document.
    pub name: String,
    /// The images.
    pub images: Vec<KeypointImage>,
}

/// One attack on one image under one scheme. Slices are `[N]`, one entry per keypoint, in the image's order.
#[derive(Debug, Clone, Copy)]
pub struct AttackTrial<'a> {
    /// Index of the image's group in the document's `data`.
    pub group: usize,
    /// The image; its keypoints are the ground truth.
    pub image: &'a KeypointImage,
    /// The scheme.
    pub scheme: Scheme,
    /// The attack.
    pub attack: Attack,
    /// Percent of the neighbours that were replaced at random.
    pub corrupt: f64,
    /// The sent observations, with quantized angles.
    pub sent: &'a Observations,
    /// The same as an attacker reads it.
    pub observations: &'a [Observation],
    /// The neighbour lists given to the attack, after replacement; also set if the attack does not use them.
    pub neighbours: &'a NeighbourLists,
    /// Recovered keypoints, pixels; may lie outside the image or not be finite.
    pub answers: &'a [Pixel],
    /// Distance of answer and truth, pixels; infinite without an answer.
    pub errors: &'a [f64],
}

/// Receives events of a running evaluation. Calls come in the order of the work: group, image, row of the document.
pub trait AttackObserver {
    /// Number of finished attacks on single images, of all.
    fn advance(&mut self, _done: usize, _total: usize) {}
    /// An attack on an image has finished.
    fn saw(&mut self, _trial: &AttackTrial<'_>) {}
}

/// Ignores all events.
impl AttackObserver for () {}

/// One stage of a long job as progress reports: it starts with the first finished attack.
pub struct AttackProgress<'a> {
    progress: &'a dyn veiloc_features::Progress,
    name: &'a str,
    started: bool,
}

impl<'a> AttackProgress<'a> {
    /// A stage with this name; nothing is reported yet.
    pub fn new(progress: &'a dyn veiloc_features::Progress, name: &'a str) -> Self {
        Self { progress, name, started: false }
    }

    /// Reports one more finished attack out of `total`, for [`AttackObserver::advance`].
    pub fn advance(&mut self, total: usize) {
        if !self.started {
            self.progress.start(self.name, total);
            self.started = true;
        }
        self.progress.advance(1);
    }
}

/// Reports progress only.
pub(super) struct Progress<F>(pub(super) F);

impl<F: FnMut(usize, usize)> AttackObserver for Progress<F> {
    fn advance(&mut self, done: usize, total: usize) {
        (self.0)(done, total);
    }
}

#[cfg(test)]
mod tests {
    use veiloc_attacks::{ErrorSummary, bits_over_prior, errors_px, prior_only};

    use super::super::{AttackEvaluation, attack_groups, evaluate_attacks};
    use super::*;
    use veiloc_datasets::problem_files::synthetic_image;

    type Key = (String, String, u64);

    #[derive(Default)]
    struct Recorder {
        steps: Vec<(usize, usize)>,
        trials: Vec<(usize, String, Key)>,
        errors: Vec<(Key, Vec<f64>)>,
        bits: f64,
        prior: Vec<f64>,
    }

    impl AttackObserver for Recorder {
        fn advance(&mut self, done: usize, total: usize) {
            self.steps.push((done, total));
        }

        fn saw(&mut self, trial: &AttackTrial<'_>) {
            let n = trial.image.keypoints.len();
            assert_eq!([trial.observations.len(), trial.answers.len(), trial.errors.len()], [n; 3]);
            for ((answer, truth), error) in trial.answers.iter().zip(&trial.image.keypoints).zip(trial.errors)
            {
                assert!((answer.distance(truth) - error).abs() < 1e-9);
            }
            // The sent line passes through the keypoint up to the dither and the quantized angle.
            for (sent, truth) in trial.observations.iter().zip(&trial.image.keypoints) {
                assert!(sent.distance(*truth) < 2.0, "{}", sent.distance(*truth));
            }
            let key = (trial.scheme.to_string(), trial.attack.to_string(), trial.corrupt as u64);
            self.trials.push((trial.group, trial.image.name.clone(), key.clone()));
            if trial.attack == Attack::PRIOR {
                let best = prior_only(trial.observations, trial.image.width, trial.image.height);
                self.prior = errors_px(best, &trial.image.keypoints);
            }
            if key == ("dcl".to_owned(), "closed-form".to_owned(), 50) {
                self.bits += bits_over_prior(trial.errors, &self.prior, 640, 480) / 2.0;
            }
            match self.errors.iter_mut().find(|(k, _)| *k == key) {
                Some((_, all)) => all.extend_from_slice(trial.errors),
                None => self.errors.push((key, trial.errors.to_vec())),
            }
        }
    }

    #[test]
    fn observed_trials_add_up_to_the_document() {
        let evaluation = AttackEvaluation {
            synthetic: 200,
            schemes: vec![Scheme::RandomLines, Scheme::default()],
            attacks: vec![Attack::CLOSED_FORM],
            corrupt: vec![0.0, 50.0],
            seed: 3,
            ..AttackEvaluation::default()
        };
        let mut own = synthetic_image(200, 9);
        own.name = "own".to_owned();
        let groups = vec![ImageGroup { name: "memory".to_owned(), images: vec![own] }];
        let mut recorder = Recorder::default();
        let document = attack_groups(&evaluation, groups, &mut recorder).expect("it runs");
        assert_eq!(document.data, ["memory", "synthetic 200"]);
        // Two images, two schemes; the baseline, and the closed form at two shares of false neighbours.
        assert_eq!(recorder.steps, (1..=12).map(|done| (done, 12)).collect::<Vec<_>>());
        assert_eq!(recorder.trials.len(), 12);
        assert_eq!((recorder.trials[0].0, recorder.trials[6].0), (0, 1));
        assert_eq!((&*recorder.trials[5].1, &*recorder.trials[6].1), ("own", "synthetic"));
        for (row, (key, errors)) in document.attacks.iter().zip(&recorder.errors) {
            assert_eq!((&*row.scheme, row.attack.name, row.corrupt as u64), (&*key.0, &*key.1, key.2));
            let sum = ErrorSummary::of(errors);
            assert!((row.mean_px - sum.mean_px).abs() < 1e-9 && row.median_px == sum.median_px, "{row:?}");
            assert_eq!((row.under_5px, row.under_30px), (sum.under_5px, sum.under_30px));
        }
        assert!((document.attacks[5].bits_over_prior - recorder.bits).abs() < 1e-9, "{document:?}");

        // An evaluation without an observer gives the same document.
        let alone = evaluate_attacks(&evaluation, |_, _| {}).expect("it runs");
        assert_eq!(alone.data, ["synthetic 200"]);
        assert!(alone.attacks.iter().zip(&document.attacks).all(|(a, b)| a.images == 1 && b.images == 2));
    }
}
