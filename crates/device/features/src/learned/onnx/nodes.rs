//! Parts of an ONNX graph as messages: nodes, attributes, tensors. Field numbers are those of ONNX's `onnx.proto`.

use super::protobuf::{put, put_number};

/// `ModelProto.graph`, `GraphProto.node` and `.initializer`.
pub(super) const GRAPH: u64 = 7;
pub(super) const NODE: u64 = 1;
pub(super) const INITIALIZER: u64 = 5;
/// `NodeProto`.
pub(super) const INPUT: u64 = 1;
pub(super) const OUTPUT: u64 = 2;
pub(super) const OPERATOR: u64 = 4;
pub(super) const ATTRIBUTE: u64 = 5;
/// A `NodeProto`.
pub(super) fn operator(kind: &str, inputs: &[&str], output: &str, attributes: &[Vec<u8>]) -> Vec<u8> {
    let mut node = Vec::new();
    for input in inputs {
        put(&mut node, INPUT, input.as_bytes());
    }
    put(&mut node, OUTPUT, output.as_bytes());
    put(&mut node, OPERATOR, kind.as_bytes());
    for attribute in attributes {
        put(&mut node, ATTRIBUTE, attribute);
    }
    node
}

/// An attribute that is a whole number: `name` 1, `i` 3, `type` 20 (INT is 2).
pub(super) fn number(name: &str, value: u64) -> Vec<u8> {
    let mut attribute = Vec::new();
    put(&mut attribute, 1, name.as_bytes());
    put_number(&mut attribute, 3, value);
    put_number(&mut attribute, 20, 2);
    attribute
}

/// A tensor of whole numbers: `dims` 1, `data_type` 2 (INT64 is 7), `name` 8, `raw_data` 9.
pub(super) fn numbers(name: &str, values: &[i64]) -> Vec<u8> {
    let mut tensor = Vec::new();
    put_number(&mut tensor, 1, values.len() as u64);
    put_number(&mut tensor, 2, 7);
    put(&mut tensor, 8, name.as_bytes());
    let raw: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    put(&mut tensor, 9, &raw);
    tensor
}

/// An attribute that is a list of whole numbers: `name` 1, `ints` 8, `type` 20 (INTS is 7).
pub(super) fn list(name: &str, values: &[u64]) -> Vec<u8> {
    let mut attribute = Vec::new();
    put(&mut attribute, 1, name.as_bytes());
    for value in values {
        put_number(&mut attribute, 8, *value);
    }
    put_number(&mut attribute, 20, 7);
    attribute
}
