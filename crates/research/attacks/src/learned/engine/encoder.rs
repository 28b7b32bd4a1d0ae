//! The network itself: an embedding, self-attention with the norm in front, and a last matrix.
//!
//! ```text
//! x [inputs, N] → matrix → (norm, attention, +; norm, two matrices, +) × layers → norm, matrix → [outputs, N]
//! ```

use crate::training::layers::{Linear, Norm, Normed, Places};

use super::Matrix;
use super::attention::{Looked, attend, attend_back};
use super::dropout::Dropout;

/// How large a network is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Shape {
    /// Numbers that are told of a keypoint.
    pub(crate) inputs: usize,
    /// Length of what stands for a keypoint within the network.
    pub(crate) width: usize,
    /// Numbers that are answered of a keypoint.
    pub(crate) outputs: usize,
    /// Heads of an attention layer; they divide `width`.
    pub(crate) heads: usize,
    /// Layers.
    pub(crate) layers: usize,
    /// Whether keypoints see each other; without, each layer thinks for itself alone.
    pub(crate) attends: bool,
}

/// What follows attention is this many times wider.
const WIDENING: usize = 2;

/// The layers of a network, by where their numbers stand.
#[derive(Debug, Clone)]
pub(crate) struct Encoder {
    input: Linear,
    blocks: Vec<Block>,
    norm: Norm,
    output: Linear,
    heads: usize,
}

/// One layer: every keypoint looks at the others, then thinks for itself.
#[derive(Debug, Clone)]
struct Block {
    attention: Option<Attention>,
    wide_norm: Norm,
    wide: Linear,
    narrow: Linear,
}

#[derive(Debug, Clone)]
struct Attention {
    norm: Norm,
    /// Queries, keys and values of all heads, one after another.
    parts: Linear,
    joined: Linear,
}

/// What the way back needs.
pub(crate) struct Tape {
    blocks: Vec<BlockTape>,
    normed: Normed,
    last: Matrix,
}

struct BlockTape {
    attention: Option<AttentionTape>,
    wide_normed: Normed,
    wide_input: Matrix,
    /// After the corner at zero.
    wide: Matrix,
    dropped: Option<Matrix>,
}

struct AttentionTape {
    normed: Normed,
    input: Matrix,
    parts: Matrix,
    looked: Looked,
    seen: Matrix,
    dropped: Option<Matrix>,
}

impl Encoder {
    pub(crate) fn new(shape: &Shape, places: &mut Places) -> Self {
        let w = shape.width;
        let input = places.linear(shape.inputs, w);
        let blocks = (0..shape.layers)
            .map(|_| Block {
                attention: shape.attends.then(|| Attention {
                    norm: places.norm(w),
                    parts: places.linear(w, 3 * w),
                    joined: places.linear(w, w),
                }),
                wide_norm: places.norm(w),
                wide: places.linear(w, WIDENING * w),
                narrow: places.linear(WIDENING * w, w),
            })
            .collect();
        let norm = places.norm(w);
        Self { input, blocks, norm, output: places.linear(w, shape.outputs), heads: shape.heads }
    }

    /// Where the last matrix stands: a network that has not learned says nothing when it is zero.
    pub(crate) fn last_weights(&self) -> std::ops::Range<usize> {
        self.output.weights()
    }

    /// `[inputs, N]` → `[outputs, N]`.
    pub(crate) fn apply(&self, numbers: &[f32], x: &Matrix) -> Matrix {
        self.run(numbers, x, &mut Dropout::none(), false).0
    }

    /// [`Self::apply`] with dropout, and what the way back needs.
    pub(crate) fn forward(&self, numbers: &[f32], x: &Matrix, dropout: &mut Dropout<'_>) -> (Matrix, Tape) {
        self.run(numbers, x, dropout, true)
    }

    fn run(&self, numbers: &[f32], x: &Matrix, dropout: &mut Dropout<'_>, keep: bool) -> (Matrix, Tape) {
        let mut x = self.input.forward(numbers, x);
        let mut blocks = Vec::new();
        for block in &self.blocks {
            let tape = block.forward(numbers, &mut x, self.heads, dropout, keep);
            if keep {
                blocks.push(tape);
            }
        }
        let (last, normed) = self.norm.forward(numbers, &x);
        let y = self.output.forward(numbers, &last);
        (y, Tape { blocks, normed, last })
    }

    /// Adds to the derivatives of all numbers, from those of what was answered, `[outputs, N]`; `x` is what came in.
    pub(crate) fn backward(&self, numbers: &[f32], slopes: &mut [f32], x: &Matrix, tape: &Tape, dy: &Matrix) {
        let dlast = self.output.backward(numbers, slopes, &tape.last, dy);
        let mut d = self.norm.backward(numbers, slopes, &tape.normed, dlast);
        for (block, tape) in self.blocks.iter().zip(&tape.blocks).rev() {
            block.backward(numbers, slopes, tape, &mut d);
        }
        self.input.learn(slopes, x, &d);
    }
}

impl Block {
    fn forward(
        &self,
        numbers: &[f32],
        x: &mut Matrix,
        heads: usize,
        dropout: &mut Dropout<'_>,
        keep: bool,
    ) -> BlockTape {
        let attention = self.attention.as_ref().map(|attention| {
            let (input, normed) = attention.norm.forward(numbers, x);
            let parts = attention.parts.forward(numbers, &input);
            let (seen, looked) = attend(&parts, heads, keep);
            let mut joined = attention.joined.forward(numbers, &seen);
            let dropped = dropout.apply(&mut joined);
            *x += joined;
            AttentionTape { normed, input, parts, looked, seen, dropped }
        });
        let (wide_input, wide_normed) = self.wide_norm.forward(numbers, x);
        let mut wide = self.wide.forward(numbers, &wide_input);
        wide.as_mut_slice().iter_mut().for_each(|v| *v = v.max(0.0));
        let mut thought = self.narrow.forward(numbers, &wide);
        let dropped = dropout.apply(&mut thought);
        *x += thought;
        BlockTape { attention, wide_normed, wide_input, wide, dropped }
    }

    /// `d`: the derivatives of what went out, made into those of what came in.
    fn backward(&self, numbers: &[f32], slopes: &mut [f32], tape: &BlockTape, d: &mut Matrix) {
        let dthought = masked(d, tape.dropped.as_ref());
        let mut dwide = self.narrow.backward(numbers, slopes, &tape.wide, &dthought);
        let corners = dwide.as_mut_slice().iter_mut().zip(tape.wide.as_slice());
        corners.filter(|(_, v)| **v <= 0.0).for_each(|(d, _)| *d = 0.0);
        let dinput = self.wide.backward(numbers, slopes, &tape.wide_input, &dwide);
        *d += self.wide_norm.backward(numbers, slopes, &tape.wide_normed, dinput);
        if let (Some(attention), Some(tape)) = (&self.attention, &tape.attention) {
            let djoined = masked(d, tape.dropped.as_ref());
            let dseen = attention.joined.backward(numbers, slopes, &tape.seen, &djoined);
            let dparts = attend_back(&tape.parts, &tape.looked, &dseen);
            let dinput = attention.parts.backward(numbers, slopes, &tape.input, &dparts);
            *d += attention.norm.backward(numbers, slopes, &tape.normed, dinput);
        }
    }
}

fn masked(d: &Matrix, factors: Option<&Matrix>) -> Matrix {
    factors.map_or_else(|| d.clone(), |f| d.component_mul(f))
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Derivatives of `⟨direction, answer⟩` against differences, with and without attention, and with dropout.
    #[test]
    fn the_way_back_is_the_derivative() {
        for (attends, dropped, n) in
            // More keypoints than one block of attention, too.
            [(true, 0.0, 11), (true, 0.0, 600), (false, 0.0, 11), (true, 0.3, 11)]
        {
            let shape = Shape { inputs: 5, width: 8, outputs: 3, heads: 2, layers: 2, attends };
            let mut places = Places::default();
            let encoder = Encoder::new(&shape, &mut places);
            let mut rng = ChaCha8Rng::seed_from_u64(4);
            // Biases away from zero, so that their derivatives are tried too.
            let numbers: Vec<f32> =
                places.draw(&mut rng).iter().map(|v| v + rng.random_range(-0.1..0.1)).collect();
            let x = Matrix::from_fn(5, n, |_, _| rng.random_range(-1.0..1.0));
            let direction = Matrix::from_fn(3, n, |_, _| rng.random_range(-1.0..1.0) / (n as f32).sqrt());
            let value = |numbers: &[f32]| {
                let mut drawn = ChaCha8Rng::seed_from_u64(9);
                let (y, tape) = encoder.forward(numbers, &x, &mut Dropout::new(dropped, &mut drawn));
                let sum: f64 = y.iter().zip(&direction).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
                (sum, tape)
            };
            let (_, tape) = value(&numbers);
            let mut slopes = vec![0.0; numbers.len()];
            encoder.backward(&numbers, &mut slopes, &x, &tape, &direction);
            // Along random directions: one number each holds every parameter.
            for _ in 0..12 {
                let along: Vec<f32> = numbers.iter().map(|_| rng.random_range(-1.0..1.0)).collect();
                let at = |t: f32| {
                    let moved: Vec<f32> = numbers.iter().zip(&along).map(|(v, a)| v + t * a).collect();
                    value(&moved).0
                };
                // Small, as the corners of the layers are many.
                let h = 1e-4;
                let measured = (at(h) - at(-h)) / f64::from(2.0 * h);
                let told: f64 = slopes.iter().zip(&along).map(|(s, a)| f64::from(*s) * f64::from(*a)).sum();
                let close = (measured - told).abs() < 0.02 * told.abs().max(1.0);
                assert!(close, "attends {attends}, dropped {dropped}: {measured} {told}");
            }
        }
    }
}
