//! NetVLAD: VGG16 to its last convolution, residuals to soft words, whitened.
//!
//! Layers, names and signs are those of hloc's `extractors/netvlad.py`, which reads the network of Arandjelović et al., *NetVLAD*,
//! CVPR 2016 (`VGG16-NetVLAD-Pitts30K`), as MATLAB's structs:
//!
//! ```text
//! x_n = f_n / |f_n|                       f: the last convolution, before its negative numbers are taken out     [D]
//! s_n = softmax(A x_n)                    A: layer 30's first weights                                            [K]
//! V_k = sum over n of s_nk (x_n - c_k)    c: layer 30's second weights, which are stored with the other sign     [D]
//! v   = V_k / |V_k|, all of length 1      number d of word k at d K + k                                          [D K]
//! y   = (W v + b) / |W v + b|             W, b: layer 33                                                         [numbers]
//! ```
//!
//! The convolutions are a graph; the rest is computed here. rten rounds products with one vector otherwise with other numbers of
//! threads, and the whitening is half a gigabyte that an engine would hold twice.

use rayon::prelude::*;

use crate::learned::onnx::{Graph, Padding};
use crate::learned::{Tensor, Weights, WeightsError};

/// Numbers of VGG16's convolutions among its layers, and whether the image is halved behind them.
const CONVOLUTIONS: [(usize, bool); 13] = [
    (0, false),
    (2, true),
    (5, false),
    (7, true),
    (10, false),
    (12, false),
    (14, true),
    (17, false),
    (19, false),
    (21, true),
    (24, false),
    (26, false),
    (28, false),
];
/// The layer of words, and that of the whitening.
const WORDS: usize = 30;
const WHITENING: usize = 33;
/// Name of the last convolution.
pub(crate) const FEATURES: &str = "features";
/// Least length that is divided by, as PyTorch has it.
const EPSILON: f32 = 1e-12;

/// What is behind the convolutions.
pub(crate) struct NetVlad {
    /// `[K, D]`
    assignment: Tensor,
    /// `[K, D]`, with the sign of the file: to be added.
    centers: Tensor,
    /// `[numbers, D K]`
    whitening: Tensor,
    /// `[numbers]`
    bias: Tensor,
}

/// The convolutions as ONNX, and what is behind them. Large weights are moved, not copied.
pub(crate) fn netvlad(mut weights: Weights) -> Result<(Vec<u8>, NetVlad), WeightsError> {
    let mut graph = Graph::default();
    let mean = weights.take("net.meta.normalization.averageImage")?;
    graph.scale("scaled", Graph::INPUT, 255.0);
    graph.subtract("input", "scaled", &mean_of_channels(&mean)?);
    let mut last = "input".to_owned();
    let mut from = 3;
    for (layer, is_halved) in CONVOLUTIONS {
        let (kernel, bias) = (name(layer, 0), name(layer, 1));
        let to = weights.shape(&bias)?.iter().product();
        let kernel = upright(weights.take(&kernel)?, &kernel, [to, from])?;
        let bias = shaped(weights.take(&bias)?, &bias, &[to])?;
        let output = if layer == 28 { FEATURES.to_owned() } else { format!("conv{layer}") };
        graph.convolution(&output, &last, &kernel, Some(&bias), Padding::One);
        last = output;
        if layer < 28 {
            let relu = format!("relu{layer}");
            graph.relu(&relu, &last);
            last = relu;
        }
        if is_halved {
            let halved = format!("pool{layer}");
            graph.max_pool(&halved, &last, 2);
            last = halved;
        }
        from = to;
    }
    graph.output(FEATURES, from);
    let (assignment, centers) = (name(WORDS, 0), name(WORDS, 1));
    let words = weights.shape(&assignment)?.first().copied().unwrap_or(0);
    let (whitening, bias) = (name(WHITENING, 0), name(WHITENING, 1));
    let numbers = weights.shape(&whitening)?.first().copied().unwrap_or(0);
    let head = NetVlad {
        assignment: shaped(weights.take(&assignment)?, &assignment, &[words, from])?,
        centers: shaped(weights.take(&centers)?, &centers, &[words, from])?,
        whitening: shaped(weights.take(&whitening)?, &whitening, &[numbers, from * words])?,
        bias: shaped(weights.take(&bias)?, &bias, &[numbers])?,
    };
    Ok((graph.model(3), head))
}

fn name(layer: usize, weights: usize) -> String {
    format!("net.layers.{layer}.weights.{weights}")
}

fn shaped(tensor: Tensor, name: &str, expected: &[usize]) -> Result<Tensor, WeightsError> {
    if tensor.shape == expected && !tensor.data.is_empty() {
        return Ok(tensor);
    }
    let (expected, actual) = (expected.to_vec(), tensor.shape);
    Err(WeightsError::Shape { name: name.to_owned(), expected, actual })
}

/// Of an image of means, the first pixel's: `[3, 1, 1]`.
fn mean_of_channels(image: &Tensor) -> Result<Tensor, WeightsError> {
    let [3, pixels @ ..] = &image.shape[..] else {
        let (expected, actual) = (vec![3], image.shape.clone());
        return Err(WeightsError::Shape { name: "averageImage".to_owned(), expected, actual });
    };
    let pixels: usize = pixels.iter().product();
    Ok(Tensor { shape: vec![3, 1, 1], data: image.data.iter().step_by(pixels.max(1)).copied().collect() })
}

/// `[out, in, 3, 3]` by columns of pixels, as MATLAB stores it, by rows.
fn upright(mut kernel: Tensor, name: &str, [to, from]: [usize; 2]) -> Result<Tensor, WeightsError> {
    // A side of one channel was left out.
    let sides = [to, from].into_iter().filter(|side| *side != 1).chain([3, 3]);
    kernel = shaped(kernel, name, &sides.collect::<Vec<_>>())?;
    kernel.shape = vec![to, from, 3, 3];
    for pixels in kernel.data.as_chunks_mut::<9>().0 {
        for (a, b) in [(1, 3), (2, 6), (5, 7)] {
            pixels.swap(a, b);
        }
    }
    Ok(kernel)
}

impl NetVlad {
    /// Numbers of the vector.
    pub(crate) fn numbers(&self) -> usize {
        self.bias.data.len()
    }

    /// The vector of an image, of length 1. `features`: `[1, D, H, W]`; `None` for other ones.
    pub(crate) fn describe(&self, features: &Tensor) -> Option<Vec<f32>> {
        let [dim, height, width] = features.image()?;
        let words = self.assignment.data.len().checked_div(dim)?;
        if self.assignment.shape != [words, dim] || height * width == 0 {
            return None;
        }
        let mut sums = vec![0.0; words * dim];
        let mut shares = vec![0.0; words];
        let mut feature = vec![0.0; dim];
        let mut scores = vec![0.0_f32; words];
        for pixel in 0..height * width {
            for (number, plane) in feature.iter_mut().zip(features.data.chunks_exact(height * width)) {
                *number = plane[pixel];
            }
            to_length_one(&mut feature);
            for (score, row) in scores.iter_mut().zip(self.assignment.data.chunks_exact(dim)) {
                *score = dot(row, &feature);
            }
            let largest = scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            for score in &mut scores {
                *score = (*score - largest).exp();
            }
            let all: f32 = scores.iter().sum();
            for ((score, share), sum) in scores.iter().zip(&mut shares).zip(sums.chunks_exact_mut(dim)) {
                let own = score / all;
                *share += own;
                for (sum, number) in sum.iter_mut().zip(&feature) {
                    *sum += own * number;
                }
            }
        }
        let residuals = sums.chunks_exact_mut(dim).zip(self.centers.data.chunks_exact(dim));
        for ((sum, center), share) in residuals.zip(&shares) {
            for (sum, center) in sum.iter_mut().zip(center) {
                *sum += share * center;
            }
            to_length_one(sum);
        }
        let mut vector: Vec<f32> = (0..dim * words).map(|at| sums[at % words * dim + at / words]).collect();
        to_length_one(&mut vector);
        let rows = self.whitening.data.par_chunks_exact(vector.len());
        let mut whitened: Vec<f32> =
            rows.zip(&self.bias.data).map(|(row, bias)| dot(row, &vector) + bias).collect();
        to_length_one(&mut whitened);
        Some(whitened)
    }
}

/// Sums of sixteen, so that they are vectorized, in one order.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (a, b) = (a.as_chunks::<16>(), b.as_chunks::<16>());
    let mut sums = [0.0; 16];
    for (a, b) in a.0.iter().zip(b.0) {
        for lane in 0..16 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    sums.iter().sum::<f32>() + a.1.iter().zip(b.1).map(|(a, b)| a * b).sum::<f32>()
}

fn to_length_one(vector: &mut [f32]) {
    let length = dot(vector, vector).sqrt().max(EPSILON);
    for number in vector {
        *number /= length;
    }
}
