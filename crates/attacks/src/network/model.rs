//! The network itself: embedding, self-attention with the norm in front, projection to unit vectors.

use burn::module::{Module, Param};
use burn::nn::{Initializer, LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::activation::{relu, softmax};
use burn::tensor::backend::Backend;
use burn::tensor::{Tensor, TensorData};

use super::dropout::Dropout;

/// How large a network is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shape {
    /// Length of a descriptor.
    pub(super) dimension: usize,
    /// Length of what stands for a keypoint within the network, and of its embedding.
    pub(super) width: usize,
    /// Heads of an attention layer; they divide `width`.
    pub(super) heads: usize,
    /// Attention layers.
    pub(super) layers: usize,
}

/// The layer behind attention is this many times wider.
const WIDENING: usize = 2;
/// Keypoints whose attention is computed together: of a whole image the table of all pairs would fill memory.
const ROWS: usize = 512;
/// Logits of pairs range from minus to plus this at the start of training.
const FIRST_SCALE: f32 = 10.0;

impl Shape {
    /// Numbers to be learned.
    pub(super) fn parameters(&self) -> u64 {
        let linear = |from: usize, to: usize| (from as u64 + 1) * to as u64;
        let (d, w) = (self.dimension, self.width);
        let norm = 2 * w as u64;
        let block =
            2 * norm + linear(w, 3 * w) + linear(w, w) + linear(w, WIDENING * w) + linear(WIDENING * w, w);
        linear(d, w) + self.layers as u64 * block + norm + linear(w, w) + 1
    }
}

/// From descriptors of one image to embeddings of its keypoints.
#[derive(Module, Debug)]
pub(super) struct Encoder<B: Backend> {
    input: Linear<B>,
    blocks: Vec<Block<B>>,
    norm: LayerNorm<B>,
    output: Linear<B>,
    /// `[1]`: logarithm of the factor from cosines to logits.
    log_scale: Param<Tensor<B, 1>>,
}

/// One layer: every keypoint looks at the others, then thinks for itself.
#[derive(Module, Debug)]
struct Block<B: Backend> {
    attention_norm: LayerNorm<B>,
    /// Queries, keys and values of all heads, one after another.
    attention: Linear<B>,
    joined: Linear<B>,
    wide_norm: LayerNorm<B>,
    wide: Linear<B>,
    narrow: Linear<B>,
    heads: usize,
}

impl<B: Backend> Encoder<B> {
    /// All weights zero: to be filled by [`super::parameters`], with what was drawn or read.
    pub(super) fn zeros(shape: &Shape, device: &B::Device) -> Self {
        let linear = |from, to| LinearConfig::new(from, to).with_initializer(Initializer::Zeros).init(device);
        let norm = || LayerNormConfig::new(shape.width).init(device);
        let w = shape.width;
        let block = |_| Block {
            attention_norm: norm(),
            attention: linear(w, 3 * w),
            joined: linear(w, w),
            wide_norm: norm(),
            wide: linear(w, WIDENING * w),
            narrow: linear(WIDENING * w, w),
            heads: shape.heads,
        };
        let log_scale = Tensor::from_data(TensorData::from([FIRST_SCALE.ln()]), device);
        Self {
            input: linear(shape.dimension, w),
            blocks: (0..shape.layers).map(block).collect(),
            norm: norm(),
            output: linear(w, w),
            log_scale: Param::from_tensor(log_scale),
        }
    }

    /// `[N, dimension]` → `[N, width]`, rows of unit length.
    pub(super) fn forward(&self, x: Tensor<B, 2>, dropout: &mut Dropout<'_>) -> Tensor<B, 2> {
        let mut x = self.input.forward(x);
        for block in &self.blocks {
            x = block.forward(x, dropout);
        }
        let x = self.output.forward(self.norm.forward(x));
        let length = x.clone().powi_scalar(2).sum_dim(1).add_scalar(1e-12).sqrt();
        x.div(length)
    }

    /// `[N, N]`: logits of pairs of one image, from its embeddings `[N, width]`.
    pub(super) fn logits(&self, embedded: Tensor<B, 2>) -> Tensor<B, 2> {
        let scaled = embedded.clone().mul(self.log_scale.val().exp().unsqueeze());
        scaled.matmul(embedded.transpose())
    }
}

impl<B: Backend> Block<B> {
    fn forward(&self, x: Tensor<B, 2>, dropout: &mut Dropout<'_>) -> Tensor<B, 2> {
        let seen = self.attend(self.attention_norm.forward(x.clone()));
        let x = x + dropout.apply(seen);
        let wide = relu(self.wide.forward(self.wide_norm.forward(x.clone())));
        let thought = self.narrow.forward(wide);
        x + dropout.apply(thought)
    }

    /// Multi-head self-attention, `[N, width]` → `[N, width]`.
    fn attend(&self, x: Tensor<B, 2>) -> Tensor<B, 2> {
        let [n, width] = x.dims();
        let (heads, each) = (self.heads, width / self.heads);
        // [3 · heads, N, each]
        let parts = self.attention.forward(x).reshape([n, 3 * heads, each]).swap_dims(0, 1);
        let part = |i: usize| parts.clone().slice([i * heads..(i + 1) * heads, 0..n, 0..each]);
        let queries = part(0).mul_scalar(1.0 / (each as f32).sqrt());
        let (keys, values) = (part(1).swap_dims(1, 2), part(2));
        let rows = (0..n).step_by(ROWS).map(|start| {
            let some = queries.clone().slice([0..heads, start..n.min(start + ROWS), 0..each]);
            softmax(some.matmul(keys.clone()), 2).matmul(values.clone())
        });
        let seen: Tensor<B, 3> = Tensor::cat(rows.collect(), 1);
        self.joined.forward(seen.swap_dims(0, 1).reshape([n, width]))
    }
}
