//! Rewrites integer convolutions as float convolutions before a model is run.
//!
//! `ConvInteger` of rten 0.24 pads images with a byte of 128 where ONNX requires the zero point, which halves the
//! scores of a quantized YOLO, and on processors without VNNI its sums saturate. The same convolution of the bytes
//! minus their zero points as floats is exact except for the rounding of sums beyond 2²⁴, and pads correctly. The
//! detector's `tests/oracle.rs` checks it. To be removed when a version with correct padding fits our minimum Rust
//! version.
//!
//! Protocol buffers are changed where necessary and copied otherwise; field numbers are those of ONNX's `onnx.proto`.

use std::collections::BTreeSet;

use super::nodes::{
    ATTRIBUTE, GRAPH, INITIALIZER, INPUT, NODE, OPERATOR, OUTPUT, list, number, numbers, operator,
};
use super::one_channel;
use super::protobuf::{Field, fields, put, text};

/// The data type of floats.
const FLOAT: u64 = 1;
/// The shape that broadcasts a zero point, per channel or common, over a kernel.
const SHAPE: &str = "veiloc:shape";

/// The model with every `ConvInteger` as a float `Conv`, and every `Conv` of one channel as the first of two
/// ([`one_channel`]); `None` when the bytes are not a protocol buffer.
pub(crate) fn exact(model: &[u8]) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(model.len() + model.len() / 8);
    for field in fields(model)? {
        match field {
            Field { number: GRAPH, payload: Some(graph), .. } => put(&mut out, GRAPH, &exact_graph(graph)?),
            field => out.extend_from_slice(field.whole),
        }
    }
    Some(out)
}

fn exact_graph(graph: &[u8]) -> Option<Vec<u8>> {
    let all = fields(graph)?;
    let one_channel_kernels = one_channel::kernels(&all);
    let kernels = one_channel::named(&all, |_| true);
    let mut out = Vec::with_capacity(graph.len());
    let (mut integers, mut single) = (false, false);
    for field in all {
        let node = field.payload.filter(|_| field.number == NODE);
        let whole = node.and_then(|node| with_steps(node, &kernels));
        let node = whole.as_deref().or(node);
        let nodes = match node.map(|node| (node, text(node, OPERATOR))) {
            Some((node, Some("ConvInteger"))) => {
                integers = true;
                Some(convolution(node)?)
            }
            Some((node, Some("Conv"))) => one_channel::first_of_two(node, &one_channel_kernels),
            _ => None,
        };
        single |= nodes.as_ref().is_some_and(|nodes| text(&nodes[0], OPERATOR) == Some("Concat"));
        match nodes {
            Some(nodes) => nodes.iter().for_each(|node| put(&mut out, NODE, node)),
            None => match &whole {
                Some(node) => put(&mut out, NODE, node),
                None => out.extend_from_slice(field.whole),
            },
        }
    }
    if integers {
        put(&mut out, INITIALIZER, &numbers(SHAPE, &[-1, 1, 1, 1]));
    }
    if single {
        for tensor in one_channel::ends() {
            put(&mut out, INITIALIZER, &tensor);
        }
    }
    Some(out)
}

/// A 2D convolution without strides or dilations, with their defaults added: rten treats omitted ones as an empty list.
/// `None` for any other node.
fn with_steps(node: &[u8], kernels: &BTreeSet<String>) -> Option<Vec<u8>> {
    if text(node, OPERATOR) != Some("Conv") {
        return None;
    }
    let all = fields(node)?;
    let kernel = all.iter().filter(|field| field.number == INPUT).nth(1)?.payload?;
    if !kernels.contains(std::str::from_utf8(kernel).ok()?) {
        return None;
    }
    let has_attribute = |what: &str| {
        all.iter().any(|f| f.number == ATTRIBUTE && f.payload.is_some_and(|a| text(a, 1) == Some(what)))
    };
    let omitted: Vec<&str> =
        ["strides", "dilations"].into_iter().filter(|what| !has_attribute(what)).collect();
    if omitted.is_empty() {
        return None;
    }
    let mut node = node.to_vec();
    for what in omitted {
        put(&mut node, ATTRIBUTE, &list(what, &[1, 1]));
    }
    Some(node)
}

/// The nodes that replace one `ConvInteger`.
fn convolution(node: &[u8]) -> Option<Vec<Vec<u8>>> {
    let all = fields(node)?;
    let texts = |number: u64| {
        let of = all.iter().filter(move |field| field.number == number);
        of.map(|field| std::str::from_utf8(field.payload?).ok()).collect::<Option<Vec<&str>>>()
    };
    let (inputs, outputs) = (texts(INPUT)?, texts(OUTPUT)?);
    let (&[image, kernel], output) = (inputs.first_chunk()?, *outputs.first()?);
    let name = |what: &str| format!("veiloc:{output}:{what}");
    let mut nodes = Vec::new();
    let mut less_zero = |what: &str, value: &str, zero: Option<&&str>, is_kernel: bool| {
        let float = name(what);
        nodes.push(operator("Cast", &[value], &float, &[number("to", FLOAT)]));
        let Some(zero) = zero.filter(|zero| !zero.is_empty()) else { return float };
        let (mut zero_float, result) = (name(&format!("{what}-zero")), name(&format!("{what}-less-zero")));
        nodes.push(operator("Cast", &[zero], &zero_float, &[number("to", FLOAT)]));
        if is_kernel {
            let shaped = name(&format!("{what}-zeros"));
            nodes.push(operator("Reshape", &[&zero_float, SHAPE], &shaped, &[]));
            zero_float = shaped;
        }
        nodes.push(operator("Sub", &[&float, &zero_float], &result, &[]));
        result
    };
    let image = less_zero("image", image, inputs.get(2), false);
    let kernel = less_zero("kernel", kernel, inputs.get(3), true);
    let attributes: Option<Vec<Vec<u8>>> = (all.iter())
        .filter(|field| field.number == ATTRIBUTE)
        .map(|field| field.payload.map(<[u8]>::to_vec))
        .collect();
    nodes.push(operator("Conv", &[&image, &kernel], output, &attributes?));
    Some(nodes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_without_integers_are_unchanged() {
        let model = include_bytes!("../../../tests/data/learned/two-boxes.onnx");
        assert_eq!(exact(model).as_deref(), Some(&model[..]));
        assert_eq!(exact(&model[..model.len() / 2]), None);
        assert_eq!(exact(b"no model"), None);
        assert_eq!(exact(&[]), Some(Vec::new()));
    }

    #[test]
    fn byte_convolution_becomes_float_convolution() {
        let stride = b"\x0a\x07strides";
        let node = operator("ConvInteger", &["x", "w", "", "wz"], "y", &[stride.to_vec()]);
        let nodes = convolution(&node).expect("a node");
        let kinds: Vec<&str> = nodes.iter().filter_map(|node| text(node, OPERATOR)).collect();
        assert_eq!(kinds, ["Cast", "Cast", "Cast", "Reshape", "Sub", "Conv"], "the image has no zero point");
        let last = fields(nodes.last().expect("a node")).expect("a message");
        assert_eq!(last.iter().find(|f| f.number == OUTPUT).and_then(|f| f.payload), Some(&b"y"[..]));
        assert_eq!(last.iter().find(|f| f.number == ATTRIBUTE).and_then(|f| f.payload), Some(&stride[..]));
        assert!(convolution(&operator("ConvInteger", &["x"], "y", &[])).is_none(), "no kernel");
    }
}
