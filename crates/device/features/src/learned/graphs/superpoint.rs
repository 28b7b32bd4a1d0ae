//! SuperPoint: a VGG-like encoder to an eighth of the size, a head of 64 positions and "none" for each cell, and a head of
//! descriptors.
//!
//! Layers and names are those of `SuperPointNet` in Magic Leap's `demo_superpoint.py`, so that its `superpoint_v1.pth` fits.
//! Outputs: `scores` `[1, 65, H/8, W/8]`, before the softmax; `descriptors` `[1, 256, H/8, W/8]`, before they get length 1.

use crate::learned::onnx::{Graph, Padding};
use crate::learned::{Weights, WeightsError};

/// Name, channels in and out.
const ENCODER: [(&str, usize, usize); 8] = [
    ("conv1a", 1, 64),
    ("conv1b", 64, 64),
    ("conv2a", 64, 64),
    ("conv2b", 64, 64),
    ("conv3a", 64, 128),
    ("conv3b", 128, 128),
    ("conv4a", 128, 128),
    ("conv4b", 128, 128),
];
/// Three by three pixels to 256 channels, then one pixel to the head's own.
const HEADS: [(&str, &str, usize, &str); 2] =
    [("convPa", "convPb", 65, "scores"), ("convDa", "convDb", 256, "descriptors")];

pub(super) fn onnx(weights: &Weights) -> Result<Vec<u8>, WeightsError> {
    let mut graph = Graph::default();
    let last = encoder(&mut graph, weights)?;
    for (wide, own, channels, output) in HEADS {
        let hidden = convolved(&mut graph, weights, &last, wide, 128, 256)?;
        let kernel = weights.get(&format!("{own}.weight"), &[channels, 256, 1, 1])?;
        let bias = weights.get(&format!("{own}.bias"), &[channels])?;
        graph.convolution(output, &hidden, kernel, Some(bias), Padding::None);
        graph.output(output, channels);
    }
    Ok(graph.model(1))
}

/// The encoder; the name of its last layer.
pub(super) fn encoder(graph: &mut Graph, weights: &Weights) -> Result<String, WeightsError> {
    let mut last = Graph::INPUT.to_owned();
    for (name, from, to) in ENCODER {
        last = convolved(graph, weights, &last, name, from, to)?;
        if matches!(name, "conv1b" | "conv2b" | "conv3b") {
            let pooled = format!("{name}.pooled");
            graph.max_pool(&pooled, &last, 2);
            last = pooled;
        }
    }
    Ok(last)
}

/// A convolution of 3 x 3 pixels, without its negative numbers; the name of the result.
fn convolved(
    graph: &mut Graph,
    weights: &Weights,
    input: &str,
    name: &str,
    from: usize,
    to: usize,
) -> Result<String, WeightsError> {
    let kernel = weights.get(&format!("{name}.weight"), &[to, from, 3, 3])?;
    let bias = weights.get(&format!("{name}.bias"), &[to])?;
    graph.convolution(name, input, kernel, Some(bias), Padding::One);
    let relu = format!("{name}.relu");
    graph.relu(&relu, name);
    Ok(relu)
}
