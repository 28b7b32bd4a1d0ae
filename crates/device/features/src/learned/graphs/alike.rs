//! ALIKE: four blocks at full size, a half, an eighth and a thirty-second, joined at full size by one convolution.
//!
//! Layers and names are those of `ALNet` in ALIKE's `nets/alnet.py`, with one head (`alike-t`, `-s`, `-n`; the file's shapes say
//! which). Two things are computed otherwise than there, with the same result but for rounding:
//!
//! - Each normalization over a training's images is folded into the convolution before it.
//! - The last convolution is of single pixels, so it is done before the enlargement for the one channel of scores, and for the
//!   channels of descriptors at keypoints alone ([`Head`]): an image has 300,000 pixels and some thousand keypoints.
//!
//! Outputs: `scores` `[1, 1, H, W]`, 0 to 1; `level1` to `level4`, `[1, dim/4, …]` at the four sizes.

use crate::learned::graphs::Made;
use crate::learned::onnx::{Graph, Padding};
use crate::learned::{Tensor, Weights, WeightsError};

/// Names of the outputs that descriptors are made of.
pub(crate) const LEVELS: [&str; 4] = ["level1", "level2", "level3", "level4"];
/// PyTorch's own of `BatchNorm2d`.
const EPSILON: f32 = 1e-5;
/// Pixels of the image for one of each level.
const SIZES: [usize; 4] = [1, 2, 8, 32];

/// The last convolution, for single pixels.
#[derive(Debug, Clone)]
pub(crate) struct Head {
    /// `[dim, dim]`, rows are numbers of the descriptor.
    kernel: Tensor,
}

impl Head {
    /// Numbers of a descriptor.
    pub(crate) fn dim(&self) -> usize {
        self.kernel.shape[0]
    }

    /// The numbers that the last convolution gives at pixel `x`, `y` of the image, into `out`. `levels`: [`LEVELS`].
    pub(crate) fn at(&self, levels: &[Tensor], [x, y]: [usize; 2], joined: &mut Vec<f32>, out: &mut [f32]) {
        joined.clear();
        let Some([_, height, width]) = levels.first().and_then(Tensor::image) else { return };
        for level in levels {
            let Some([channels, rows, columns]) = level.image() else { return };
            // Corner upon corner.
            let along = |at: usize, from: usize, to: usize| {
                let place = if from > 1 { at as f32 * (to - 1) as f32 / (from - 1) as f32 } else { 0.0 };
                let first = (place as usize).min(to - 1);
                (first, (first + 1).min(to - 1), place - first as f32)
            };
            let ((left, right, across), (upper, lower, down)) =
                (along(x, width, columns), along(y, height, rows));
            for channel in 0..channels {
                let plane = &level.data[channel * rows * columns..][..rows * columns];
                let row = |row: usize| {
                    let (a, b) = (plane[row * columns + left], plane[row * columns + right]);
                    a + (b - a) * across
                };
                let (above, below) = (row(upper), row(lower));
                joined.push(above + (below - above) * down);
            }
        }
        for (number, row) in out.iter_mut().zip(self.kernel.data.chunks_exact(joined.len())) {
            *number = row.iter().zip(&*joined).map(|(w, v)| w * v).sum();
        }
    }
}

pub(super) fn made(weights: &Weights) -> Result<Made, WeightsError> {
    let channels = |block: &str| weights.channels(&format!("{block}.conv2.weight"));
    let widths = [channels("block1")?, channels("block2")?, channels("block3")?, channels("block4")?];
    let quarter = weights.channels("conv1.weight")?;
    if let Some(odd) = widths.iter().chain([&quarter]).find(|sides| !(1..=1024).contains(*sides)) {
        let name = "conv1.weight".to_owned();
        return Err(WeightsError::Shape { name, expected: vec![1024], actual: vec![*odd] });
    }
    let dim = 4 * quarter;
    let mut graph = Graph::default();
    let head = weights.get("convhead2.weight", &[dim + 1, dim, 1, 1])?;
    let mut input = Graph::INPUT.to_owned();
    let mut from = 3;
    let mut scores = String::new();
    for (i, (block, width)) in ["block1", "block2", "block3", "block4"].into_iter().zip(widths).enumerate() {
        if i > 0 {
            let pooled = format!("{block}.pooled");
            graph.max_pool(&pooled, &input, if i == 1 { 2 } else { 4 });
            input = pooled;
        }
        input = block_of(&mut graph, weights, block, &input, [from, width], i > 0)?;
        from = width;
        let kernel = weights.get(&format!("conv{}.weight", i + 1), &[quarter, width, 1, 1])?;
        let flat = format!("conv{}", i + 1);
        graph.convolution(&flat, &input, kernel, None, Padding::None);
        graph.relu(LEVELS[i], &flat);
        graph.output(LEVELS[i], quarter);
        // The row of scores, of the channels that this level gives.
        let own = &head.data[dim * dim + i * quarter..][..quarter];
        let own = Tensor { shape: vec![1, quarter, 1, 1], data: own.to_vec() };
        let part = format!("score{}", i + 1);
        graph.convolution(&part, LEVELS[i], &own, None, Padding::None);
        let enlarged = match SIZES[i] {
            1 => part,
            times => {
                let enlarged = format!("{part}.enlarged");
                graph.enlarge(&enlarged, &part, times as f32);
                enlarged
            }
        };
        scores = if i == 0 {
            enlarged
        } else {
            let sum = format!("score{}.sum", i + 1);
            graph.add(&sum, &scores, &enlarged);
            sum
        };
    }
    graph.sigmoid("scores", &scores);
    graph.output("scores", 1);
    let kernel = Tensor { shape: vec![dim, dim], data: head.data[..dim * dim].to_vec() };
    Ok(Made { onnx: graph.model(3), head: Some(Head { kernel }) })
}

/// Two convolutions; with `residual` what came in is added before the last negative numbers are taken out.
fn block_of(
    graph: &mut Graph,
    weights: &Weights,
    block: &str,
    input: &str,
    [from, to]: [usize; 2],
    residual: bool,
) -> Result<String, WeightsError> {
    let folded = |number: usize, from: usize| folded(weights, block, number, [from, to]);
    let name = |what: &str| format!("{block}.{what}");
    let (first, second) = (name("first"), name("second"));
    let (kernel, bias) = folded(1, from)?;
    graph.convolution(&first, input, &kernel, Some(&bias), Padding::One);
    graph.relu(&name("first.relu"), &first);
    let (kernel, bias) = folded(2, to)?;
    graph.convolution(&second, &name("first.relu"), &kernel, Some(&bias), Padding::One);
    let mut last = second;
    if residual {
        let kernel = weights.get(&name("downsample.weight"), &[to, from, 1, 1])?;
        let bias = weights.get(&name("downsample.bias"), &[to])?;
        graph.convolution(&name("aside"), input, kernel, Some(bias), Padding::None);
        graph.add(&name("sum"), &last, &name("aside"));
        last = name("sum");
    }
    graph.relu(block, &last);
    Ok(block.to_owned())
}

/// A convolution of 3 x 3 pixels with the normalization behind it: `γ (w x − μ) / √(σ² + ε) + β`.
fn folded(
    weights: &Weights,
    block: &str,
    number: usize,
    [from, to]: [usize; 2],
) -> Result<(Tensor, Tensor), WeightsError> {
    let of = |what: &str| weights.get(&format!("{block}.bn{number}.{what}"), &[to]);
    let (gamma, beta) = (of("weight")?, of("bias")?);
    let (mean, variance) = (of("running_mean")?, of("running_var")?);
    let mut kernel = weights.get(&format!("{block}.conv{number}.weight"), &[to, from, 3, 3])?.clone();
    let mut bias = Tensor { shape: vec![to], data: Vec::with_capacity(to) };
    for channel in 0..to {
        let factor = gamma.data[channel] / (variance.data[channel] + EPSILON).sqrt();
        for weight in &mut kernel.data[channel * from * 9..][..from * 9] {
            *weight *= factor;
        }
        bias.data.push(beta.data[channel] - mean.data[channel] * factor);
    }
    Ok((kernel, bias))
}
