//! The training: AdamW on random subsets of the training images, judged on images that are never learned from.

use burn::backend::Autodiff;
use burn::backend::ndarray::NdArrayDevice;
use burn::grad_clipping::GradientClippingConfig;
use burn::module::AutodiffModule;
use burn::optim::{AdamWConfig, GradientsParams, Optimizer};
use burn::tensor::{Tensor, TensorData};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::batches::{Batch, Lesson};
use super::dropout::Dropout;
use super::error::NetworkError;
use super::loss::loss;
use super::model::{Encoder, Shape};
use super::options::TrainingOptions;
use super::schedule::learning_rate;
use super::{Cpu, NeighbourNetwork, parameters};
use crate::error::AttackError;
use crate::features::KnownImage;
use crate::neighbours::NeighbourLists;

/// Where networks are trained.
type Learning = Autodiff<Cpu>;

/// Length of the lists whose precision is watched, and by which the best step is chosen.
pub const PRECISION_AT: usize = 20;
/// Gradients longer than this are made shorter.
const LONGEST_GRADIENT: f32 = 1.0;

/// How far training was at one look at the validation images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurvePoint {
    /// Steps done.
    pub step: usize,
    /// Mean loss of the steps since the last point.
    pub loss: f64,
    /// Share of the [`PRECISION_AT`] likeliest neighbours that are among as many nearest, validation images.
    pub precision: f64,
}

/// What training gave.
#[derive(Debug, Clone)]
pub struct Trained {
    /// The network of the best look at the validation images.
    pub network: NeighbourNetwork,
    /// Steps done at that look.
    pub best_step: usize,
    /// All looks.
    pub curve: Vec<CurvePoint>,
}

/// Trains a network, and keeps that of the best precision on the `validation` images.
///
/// `observe` is called after every step with the number of steps done, and with the point of the curve when there is
/// one. The validation images should be of other places than the `training` images, and what is said about an
/// unseen place must be measured on a third one, as the step was chosen on these.
///
/// # Errors
/// [`NetworkError::Option`] for options that make no sense, [`NetworkError::Attack`] when there is nothing to learn or
/// judge, or descriptors differ in dimension, [`NetworkError::Diverged`] when the loss is no number any more.
pub fn train(
    training: &[KnownImage],
    validation: &[KnownImage],
    options: &TrainingOptions,
    mut observe: impl FnMut(usize, Option<&CurvePoint>),
) -> Result<Trained, NetworkError> {
    let dimension = training.first().map_or(0, |p| p.descriptors().columns().nrows());
    if dimension == 0 || validation.is_empty() {
        return Err(AttackError::NothingToLearn.into());
    }
    let shape = options.shape(dimension)?;
    for image in training.iter().chain(validation) {
        let found = image.descriptors().columns().nrows();
        if found != dimension {
            return Err(AttackError::Dimensions { expected: dimension, found }.into());
        }
    }
    let lessons: Vec<Lesson> = training.iter().filter_map(|p| Lesson::new(p, options.neighbours)).collect();
    if lessons.is_empty() {
        return Err(AttackError::NothingToLearn.into());
    }
    let truth: Vec<NeighbourLists> =
        validation.iter().map(|p| NeighbourLists::nearest(p.keypoints(), PRECISION_AT)).collect();

    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let mut encoder: Encoder<Learning> = parameters::drawn(&shape, &mut rng, &NdArrayDevice::default());
    let mut optimizer = AdamWConfig::new()
        .with_weight_decay(options.weight_decay as f32)
        .with_grad_clipping(Some(GradientClippingConfig::Norm(LONGEST_GRADIENT)))
        .init();
    let mut curve: Vec<CurvePoint> = Vec::new();
    let mut best: Option<(f64, NeighbourNetwork, usize)> = None;
    let (mut losses, mut since) = (0.0, 0.0);
    for step in 0..options.steps {
        let images: Vec<Batch> = (0..options.images)
            .map(|_| lessons[rng.random_range(0..lessons.len())].draw(options.keypoints, &mut rng))
            .collect();
        let wrong = step_loss(&encoder, &images, &shape, options.dropout, &mut rng);
        let value = f64::from(wrong.clone().into_scalar());
        if !value.is_finite() {
            return Err(NetworkError::Diverged { step });
        }
        let gradients = GradientsParams::from_grads(wrong.backward(), &encoder);
        encoder =
            optimizer.step(learning_rate(options.learning_rate, step, options.steps), encoder, gradients);
        losses += value;
        since += 1.0;

        let done = step + 1;
        if done % options.validate_every != 0 && done != options.steps {
            observe(done, None);
            continue;
        }
        let network = NeighbourNetwork { shape, encoder: encoder.valid() };
        let precision = precision(&network, validation, &truth)?;
        let point = CurvePoint { step: done, loss: losses / since, precision };
        (losses, since) = (0.0, 0.0);
        curve.push(point);
        if best.as_ref().is_none_or(|b| precision > b.0) {
            best = Some((precision, network, done));
        }
        observe(done, Some(&point));
    }
    // The last step is always judged, and there is at least one.
    let (_, network, best_step) = best.ok_or(AttackError::NothingToLearn)?;
    Ok(Trained { network, best_step, curve })
}

/// Mean loss of some images, `[1]`.
fn step_loss(
    encoder: &Encoder<Learning>,
    images: &[Batch],
    shape: &Shape,
    dropped: f64,
    rng: &mut ChaCha8Rng,
) -> Tensor<Learning, 1> {
    let device = NdArrayDevice::default();
    let mut sum = Tensor::zeros([1], &device);
    for batch in images {
        let input = TensorData::new(batch.input.clone(), [batch.len, shape.dimension]);
        let targets = TensorData::new(batch.targets.clone(), [batch.len, batch.len]);
        let embedded = encoder.forward(Tensor::from_data(input, &device), &mut Dropout::new(dropped, rng));
        let targets = Tensor::from_data(targets, &device);
        sum = sum + loss(encoder.logits(embedded), targets, batch.rows);
    }
    sum.div_scalar(images.len() as f32)
}

/// Precision over all entries of all images.
fn precision(
    network: &NeighbourNetwork,
    images: &[KnownImage],
    truth: &[NeighbourLists],
) -> Result<f64, AttackError> {
    let (mut right, mut entries) = (0.0, 0.0);
    for (image, near) in images.iter().zip(truth) {
        let said = network.predict(image.descriptors(), PRECISION_AT)?;
        let count = (0..said.len()).map(|i| said.of(i).len()).sum::<usize>() as f64;
        if count > 0.0 {
            right += count * said.precision(near);
            entries += count;
        }
    }
    Ok(if entries > 0.0 { right / entries } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use veiloc_geometry::Pixel;

    use super::*;
    use crate::features::Descriptors;

    /// The gradient that training follows, against differences of the loss.
    #[test]
    fn the_gradient_is_that_of_the_loss() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let keypoints: Vec<Pixel> =
            (0..12).map(|_| Pixel::new(rng.random_range(0.0..9.0), rng.random_range(0.0..9.0))).collect();
        let bytes: Vec<u8> = (0..12 * 6).map(|_| rng.random()).collect();
        let descriptors = Descriptors::new(&bytes, 6).expect("whole");
        let image = KnownImage::new(keypoints, descriptors, 9, 9).expect("one each");
        let lesson = Lesson::new(&image, 3).expect("neighbours");
        let batch = [lesson.draw(10, &mut rng)];

        let shape = Shape { dimension: 6, width: 8, heads: 2, layers: 2 };
        let device = NdArrayDevice::default();
        let drawn: Encoder<Learning> = parameters::drawn(&shape, &mut rng, &device);
        // Biases away from zero, so that their gradients are tried too.
        let values: Vec<f32> =
            parameters::list(&drawn).iter().map(|v| v + rng.random_range(-0.05..0.05)).collect();
        let of = |values: &[f32]| {
            let encoder: Encoder<Learning> = parameters::filled(&shape, values, &device);
            let mut unused = ChaCha8Rng::seed_from_u64(0);
            let value = step_loss(&encoder, &batch, &shape, 0.0, &mut unused);
            (encoder, value)
        };
        let (encoder, value) = of(&values);
        let gradients = value.backward();
        let slope = parameters::slopes(&encoder, &gradients);
        assert_eq!(slope.len(), values.len());
        assert_eq!(slope.len() as u64, shape.parameters());
        // Along random directions: one number each holds every parameter.
        for _ in 0..8 {
            let along: Vec<f32> = values.iter().map(|_| rng.random_range(-1.0..1.0)).collect();
            let at = |t: f32| {
                let moved: Vec<f32> = values.iter().zip(&along).map(|(v, a)| v + t * a).collect();
                f64::from(of(&moved).1.into_scalar())
            };
            let h = 2e-3;
            let measured = (at(h) - at(-h)) / f64::from(2.0 * h);
            let told: f64 = slope.iter().zip(&along).map(|(s, a)| f64::from(*s) * f64::from(*a)).sum();
            assert!((measured - told).abs() < 0.03 * told.abs().max(0.3), "{measured} {told}");
        }
    }
}
