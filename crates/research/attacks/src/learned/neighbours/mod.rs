//! An attention network over the set of descriptors of an image, which predicts who is whose neighbour.
//!
//! After Chelani et al., *Obfuscation Based Privacy Preserving Representations are Recoverable Using Neighborhood
//! Information*: every descriptor is embedded, self-attention lets it see the others of its image, and a pair is the
//! likelier the more alike its embeddings are. Nothing but descriptors goes in; positions are needed for training
//! alone, on images that the attacker took himself.
//!
//! ```text
//! descriptors [dimension, N] → matrix → (norm, attention, +; norm, two matrices, +) × layers → norm, matrix, unit length
//! logit of (i, j) = e^s ⟨eᵢ, eⱼ⟩,   loss = mean over i and the neighbours j of i of −log softmax_j
//! ```

mod file;
mod lessons;
mod loss;

use std::ops::ControlFlow;

use crate::training::layers::Places;
use crate::training::{Progress, Subject, Trained, TrainingState, begin, learn};
use crate::{AttackError, Descriptors, KnownImage, NeighbourLists, likeliest_pairs};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::learned::engine::dropout::Dropout;
use crate::learned::engine::encoder::{Encoder, Shape};
use crate::learned::options::{TrainingOptions, refuse};

use lessons::Lesson;
pub(crate) use lessons::input;
use loss::{loss, unit};

/// Length of the lists whose precision is watched, and by which the best step is chosen.
pub const PRECISION_AT: usize = 20;
/// Logits of pairs range from minus to plus this at the start of training.
const FIRST_SCALE: f32 = 10.0;

/// Says from descriptors alone which keypoints are likely neighbours; made by [`train`] or [`Self::decode`].
#[derive(Debug, Clone)]
pub struct NeighbourNetwork {
    layers: Layers,
    numbers: Vec<f32>,
}

/// The layers, by where their numbers stand.
#[derive(Debug, Clone)]
struct Layers {
    shape: Shape,
    encoder: Encoder,
    /// Where the logarithm of the factor from cosines to logits stands.
    log_scale: usize,
}

impl Layers {
    fn new(shape: Shape) -> (Self, Places) {
        let mut places = Places::default();
        let encoder = Encoder::new(&shape, &mut places);
        let log_scale = places.number();
        (Self { shape, encoder, log_scale }, places)
    }

    fn predict(
        &self,
        numbers: &[f32],
        descriptors: &Descriptors,
        k: usize,
    ) -> Result<NeighbourLists, AttackError> {
        if descriptors.dimension() != self.shape.inputs {
            let found = descriptors.dimension();
            return Err(AttackError::Dimensions { expected: self.shape.inputs, found });
        }
        if descriptors.is_empty() {
            return NeighbourLists::from_lists(&[]);
        }
        // Unit columns, the more alike the likelier neighbours.
        let (embedded, _) = unit(&self.encoder.apply(numbers, &input(descriptors)));
        let nothing = vec![0.0; embedded.ncols()];
        NeighbourLists::from_lists(&likeliest_pairs(&embedded, &embedded, &nothing, k))
    }
}

impl NeighbourNetwork {
    /// The `k` likeliest neighbours of each keypoint, likeliest first, equal ones by index.
    ///
    /// # Errors
    /// [`AttackError::Dimensions`] when the descriptors are of another dimension than those learned from.
    pub fn predict(&self, descriptors: &Descriptors, k: usize) -> Result<NeighbourLists, AttackError> {
        self.layers.predict(&self.numbers, descriptors, k)
    }

    /// How many numbers were learned.
    pub fn parameters(&self) -> usize {
        self.numbers.len()
    }
}

/// Trains a network, and keeps that of the best precision on the `validation` images.
///
/// The `neighbours` nearest keypoints of each in the whole image count as its neighbours. `earlier` is an interrupted
/// training of the same options and images, which goes on. `observe` is called after every step, and may break off.
/// The validation images should be of other places than the `training` images, and what is said about an unseen place
/// must be measured on a third one, as the step was chosen on these.
///
/// # Errors
/// [`AttackError::Option`] for options that make no sense, an [`AttackError`] when there is nothing to learn or
/// judge, or descriptors differ in dimension, [`AttackError::Diverged`] when the loss is no number any more,
/// [`AttackError::OtherTraining`] when the earlier training was another one.
pub fn train(
    training: &[KnownImage],
    validation: &[KnownImage],
    neighbours: usize,
    options: &TrainingOptions,
    earlier: Option<TrainingState>,
    observe: impl FnMut(Progress<'_>) -> ControlFlow<()>,
) -> Result<Trained<NeighbourNetwork>, AttackError> {
    let dimension = one_dimension(training, validation)?;
    options.check()?;
    if neighbours == 0 {
        return Err(refuse("neighbours", 0, "at least 1"));
    }
    let (width, heads) = (options.width, options.heads);
    let shape =
        Shape { inputs: dimension, width, outputs: width, heads, layers: options.layers, attends: true };
    shape.check()?;
    let lessons: Vec<Lesson> = training.iter().filter_map(|p| Lesson::new(p, neighbours)).collect();
    if lessons.is_empty() {
        return Err(AttackError::NothingToLearn);
    }
    let (layers, places) = Layers::new(shape);
    let mut numbers = places.draw(&mut ChaCha8Rng::seed_from_u64(options.seed));
    numbers[layers.log_scale] = FIRST_SCALE.ln();
    let truth = validation.iter().map(|p| NeighbourLists::nearest(p.keypoints(), PRECISION_AT)).collect();
    let what = format!("neighbours {neighbours}");
    let state = begin(numbers, options.fingerprint(&what, [training, validation]), earlier)?;
    let subject = Neighbours { layers: layers.clone(), lessons, validation, truth, options };
    let trained = learn(&subject, &places.decaying(), &options.course(), state, observe)?;
    Ok(Trained {
        network: NeighbourNetwork { layers, numbers: trained.network },
        best_step: trained.best_step,
        curve: trained.curve,
        state: trained.state,
    })
}

/// The dimension of all descriptors.
pub(crate) fn one_dimension(
    training: &[KnownImage],
    validation: &[KnownImage],
) -> Result<usize, AttackError> {
    let dimension = training.first().map_or(0, |p| p.descriptors().dimension());
    if dimension == 0 || validation.is_empty() {
        return Err(AttackError::NothingToLearn);
    }
    for image in training.iter().chain(validation) {
        let found = image.descriptors().dimension();
        if found != dimension {
            return Err(AttackError::Dimensions { expected: dimension, found });
        }
    }
    Ok(dimension)
}

struct Neighbours<'a> {
    layers: Layers,
    lessons: Vec<Lesson>,
    validation: &'a [KnownImage],
    truth: Vec<NeighbourLists>,
    options: &'a TrainingOptions,
}

impl Subject for Neighbours<'_> {
    fn lesson(&self, numbers: &[f32], slopes: &mut [f32], rng: &mut ChaCha8Rng) -> f64 {
        let lesson = &self.lessons[rng.random_range(0..self.lessons.len())];
        let batch = lesson.draw(self.options.keypoints, rng);
        let mut dropout = Dropout::new(self.options.dropout, rng);
        let Layers { encoder, log_scale, .. } = &self.layers;
        let (embedded, tape) = encoder.forward(numbers, &batch.input, &mut dropout);
        let judged = loss(&embedded, numbers[*log_scale], &batch.targets, batch.rows);
        encoder.backward(numbers, slopes, &batch.input, &tape, &judged.slopes);
        slopes[*log_scale] += judged.scale;
        judged.loss
    }

    /// Precision over all entries of all images.
    fn judge(&self, numbers: &[f32]) -> f64 {
        let (mut right, mut entries) = (0.0, 0.0);
        for (image, near) in self.validation.iter().zip(&self.truth) {
            let said = self.layers.predict(numbers, image.descriptors(), PRECISION_AT);
            let said = said.expect("dimensions were compared before training");
            let count = (0..said.len()).map(|i| said.of(i).len()).sum::<usize>() as f64;
            if count > 0.0 {
                right += count * said.precision(near);
                entries += count;
            }
        }
        if entries > 0.0 { right / entries } else { 0.0 }
    }
}
