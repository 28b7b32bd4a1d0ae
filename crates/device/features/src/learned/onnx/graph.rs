//! Writes an ONNX graph: for networks whose files hold tensors and no graph.
//!
//! Each layer is named by its caller, and its result has that name, so that a test can ask for any of them. Field numbers
//! are those of ONNX's `onnx.proto`.

use super::nodes::list;
use super::protobuf::{put, put_number};
use crate::learned::Tensor;

/// ONNX's own number of the format, and of the operators' version.
const IR_VERSION: u64 = 8;
const OPSET: u64 = 13;

/// What surrounds an image before a convolution.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Padding {
    /// Nothing: a kernel of one pixel.
    None,
    /// One pixel of zeros on each side: a kernel of 3 x 3.
    One,
}

/// A graph with one input, [`Graph::INPUT`], of any height and width.
#[derive(Default)]
pub(crate) struct Graph {
    nodes: Vec<u8>,
    initializers: Vec<u8>,
    outputs: Vec<u8>,
}

impl Graph {
    /// Name of the input, `[1, C, H, W]`.
    pub(crate) const INPUT: &'static str = "image";

    /// A convolution with stride 1. `kernel`: `[out, in, k, k]`; `bias`: `[out]`.
    pub(crate) fn convolution(
        &mut self,
        name: &str,
        input: &str,
        kernel: &Tensor,
        bias: Option<&Tensor>,
        padding: Padding,
    ) {
        let side = match padding {
            Padding::None => 0,
            Padding::One => 1,
        };
        self.strided(name, input, kernel, bias, [side, 1]);
    }

    /// The same with this many pixels of zeros on each side, and this stride.
    pub(crate) fn strided(
        &mut self,
        name: &str,
        input: &str,
        kernel: &Tensor,
        bias: Option<&Tensor>,
        [side, stride]: [u64; 2],
    ) {
        let (kernel_name, bias_name) = (format!("{name}.kernel"), format!("{name}.bias"));
        self.tensor(&kernel_name, kernel);
        let mut inputs = vec![input, &kernel_name];
        if let Some(bias) = bias {
            self.tensor(&bias_name, bias);
            inputs.push(&bias_name);
        }
        let attributes =
            [list("pads", &[side; 4]), list("strides", &[stride; 2]), list("dilations", &[1; 2])];
        self.node("Conv", &inputs, name, &attributes);
    }

    /// Zero in place of what is negative.
    pub(crate) fn relu(&mut self, name: &str, input: &str) {
        self.node("Relu", &[input], name, &[]);
    }

    /// 1 / (1 + exp(-x)).
    pub(crate) fn sigmoid(&mut self, name: &str, input: &str) {
        self.node("Sigmoid", &[input], name, &[]);
    }

    /// The largest of each `side` x `side` pixels.
    pub(crate) fn max_pool(&mut self, name: &str, input: &str, side: u64) {
        self.overlapping_pool(name, input, [side, side]);
    }

    /// The largest of `side` x `side` pixels, every `stride` pixels.
    pub(crate) fn overlapping_pool(&mut self, name: &str, input: &str, [side, stride]: [u64; 2]) {
        let attributes = [list("kernel_shape", &[side; 2]), list("strides", &[stride; 2])];
        self.node("MaxPool", &[input], name, &attributes);
    }

    /// Every number times a factor.
    pub(crate) fn scale(&mut self, name: &str, input: &str, factor: f32) {
        let factors = format!("{name}.factor");
        self.tensor(&factors, &Tensor { shape: vec![1], data: vec![factor] });
        self.node("Mul", &[input, &factors], name, &[]);
    }

    /// Less a number for each channel. `shift`: `[C, 1, 1]`.
    pub(crate) fn subtract(&mut self, name: &str, input: &str, shift: &Tensor) {
        let shifts = format!("{name}.shift");
        self.tensor(&shifts, shift);
        self.node("Sub", &[input, &shifts], name, &[]);
    }

    /// The sum of two images of one size.
    pub(crate) fn add(&mut self, name: &str, first: &str, second: &str) {
        self.node("Add", &[first, second], name, &[]);
    }

    /// An image `times` as wide and high, interpolated linearly, corner upon corner (PyTorch's `align_corners`).
    pub(crate) fn enlarge(&mut self, name: &str, input: &str, times: f32) {
        let scales = format!("{name}.scales");
        self.tensor(&scales, &Tensor { shape: vec![4], data: vec![1.0, 1.0, times, times] });
        let attributes = [text("mode", "linear"), text("coordinate_transformation_mode", "align_corners")];
        self.node("Resize", &[input, "", &scales], name, &attributes);
    }

    /// Makes a layer an output. `channels`: how many it has.
    pub(crate) fn output(&mut self, name: &str, channels: usize) {
        put(&mut self.outputs, 12, &value(name, channels));
    }

    /// The whole model. `channels`: of the input.
    pub(crate) fn model(self, channels: usize) -> Vec<u8> {
        let mut graph = self.nodes;
        put(&mut graph, 2, b"veiloc");
        graph.extend(self.initializers);
        put(&mut graph, 11, &value(Self::INPUT, channels));
        graph.extend(self.outputs);
        let mut opset = Vec::new();
        put_number(&mut opset, 2, OPSET);
        let mut model = Vec::new();
        put_number(&mut model, 1, IR_VERSION);
        put(&mut model, 7, &graph);
        put(&mut model, 8, &opset);
        model
    }

    fn node(&mut self, kind: &str, inputs: &[&str], output: &str, attributes: &[Vec<u8>]) {
        let mut node = Vec::new();
        for input in inputs {
            put(&mut node, 1, input.as_bytes());
        }
        // An operator has no name of its own: rten would take it for its result's.
        put(&mut node, 2, output.as_bytes());
        put(&mut node, 4, kind.as_bytes());
        for attribute in attributes {
            put(&mut node, 5, attribute);
        }
        put(&mut self.nodes, 1, &node);
    }

    /// `TensorProto` of floats (data type 1).
    fn tensor(&mut self, name: &str, tensor: &Tensor) {
        let mut message = Vec::new();
        for side in &tensor.shape {
            put_number(&mut message, 1, *side as u64);
        }
        put_number(&mut message, 2, 1);
        put(&mut message, 8, name.as_bytes());
        let raw: Vec<u8> = tensor.data.iter().flat_map(|number| number.to_le_bytes()).collect();
        put(&mut message, 9, &raw);
        put(&mut self.initializers, 5, &message);
    }
}

/// `AttributeProto` of a text (type 3).
fn text(name: &str, value: &str) -> Vec<u8> {
    let mut attribute = Vec::new();
    put(&mut attribute, 1, name.as_bytes());
    put(&mut attribute, 4, value.as_bytes());
    put_number(&mut attribute, 20, 3);
    attribute
}

/// `ValueInfoProto` of floats `[1, channels, ?, ?]`.
fn value(name: &str, channels: usize) -> Vec<u8> {
    let mut shape = Vec::new();
    for side in [Some(1), Some(channels as u64), None, None] {
        let mut dimension = Vec::new();
        match side {
            Some(side) => put_number(&mut dimension, 1, side),
            // A dimension is told apart by its name.
            None => put(&mut dimension, 2, format!("{name}.{}", shape.len()).as_bytes()),
        }
        put(&mut shape, 1, &dimension);
    }
    let (mut tensor, mut kind, mut value) = (Vec::new(), Vec::new(), Vec::new());
    put_number(&mut tensor, 1, 1);
    put(&mut tensor, 2, &shape);
    put(&mut kind, 1, &tensor);
    put(&mut value, 1, name.as_bytes());
    put(&mut value, 2, &kind);
    value
}
