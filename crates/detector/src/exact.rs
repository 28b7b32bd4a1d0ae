//! Convolutions in whole numbers, computed in floats: a change to the model before it is run.
//!
//! `ConvInteger` of rten 0.24 continues images by a byte of 128 where ONNX wants the zero point, which halves the scores of a
//! quantized YOLO, and on processors without VNNI its sums saturate. The same convolution of the bytes less their zero points
//! as floats is exact but for the rounding of sums beyond 2²⁴, and is continued by what zero stands for. `tests/oracle.rs` is
//! the judge. To be dropped when a version that fits our minimum Rust continues images right.
//!
//! Protocol buffers are changed where that takes it and copied elsewhere; field numbers are those of ONNX's `onnx.proto`.

/// `ModelProto.graph`, `GraphProto.node` and `.initializer`.
const GRAPH: u64 = 7;
const NODE: u64 = 1;
const INITIALIZER: u64 = 5;
/// `NodeProto`.
const INPUT: u64 = 1;
const OUTPUT: u64 = 2;
const OPERATOR: u64 = 4;
const ATTRIBUTE: u64 = 5;
/// The shape that makes a zero point for each channel, or one for all, broadcast over a kernel.
const SHAPE: &str = "veiloc:shape";

/// The model with every `ConvInteger` as a `Conv` of floats; `None` when the bytes are no protocol buffer.
pub(crate) fn in_floats(model: &[u8]) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(model.len() + model.len() / 8);
    for field in fields(model)? {
        match field {
            Field { number: GRAPH, payload: Some(graph), .. } => {
                put(&mut out, GRAPH, &graph_in_floats(graph)?);
            }
            field => out.extend_from_slice(field.whole),
        }
    }
    Some(out)
}

fn graph_in_floats(graph: &[u8]) -> Option<Vec<u8>> {
    let (mut out, mut changed) = (Vec::with_capacity(graph.len()), false);
    for field in fields(graph)? {
        match field {
            Field { number: NODE, payload: Some(node), .. }
                if text(node, OPERATOR) == Some("ConvInteger") =>
            {
                changed = true;
                for node in convolution(node)? {
                    put(&mut out, NODE, &node);
                }
            }
            field => out.extend_from_slice(field.whole),
        }
    }
    if changed {
        put(&mut out, INITIALIZER, &shape());
    }
    Some(out)
}

/// The nodes that take the place of one `ConvInteger`.
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
        nodes.push(operator("Cast", &[value], &float, &[to_float()]));
        let Some(zero) = zero.filter(|zero| !zero.is_empty()) else { return float };
        let (mut zero_float, result) = (name(&format!("{what}-zero")), name(&format!("{what}-less-zero")));
        nodes.push(operator("Cast", &[zero], &zero_float, &[to_float()]));
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

/// A `NodeProto`.
fn operator(kind: &str, inputs: &[&str], output: &str, attributes: &[Vec<u8>]) -> Vec<u8> {
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

/// The attribute `to = FLOAT` of `Cast`: `name` 1, `i` 3, `type` 20 (INT is 2).
fn to_float() -> Vec<u8> {
    let mut attribute = Vec::new();
    put(&mut attribute, 1, b"to");
    put_number(&mut attribute, 3, 1);
    put_number(&mut attribute, 20, 2);
    attribute
}

/// The tensor `[-1, 1, 1, 1]`: `dims` 1, `data_type` 2 (INT64 is 7), `name` 8, `raw_data` 9.
fn shape() -> Vec<u8> {
    let mut tensor = Vec::new();
    put_number(&mut tensor, 1, 4);
    put_number(&mut tensor, 2, 7);
    put(&mut tensor, 8, SHAPE.as_bytes());
    let raw: Vec<u8> = [-1_i64, 1, 1, 1].iter().flat_map(|side| side.to_le_bytes()).collect();
    put(&mut tensor, 9, &raw);
    tensor
}

/// A field of a message.
struct Field<'a> {
    number: u64,
    /// What is in it, where it has a length.
    payload: Option<&'a [u8]>,
    /// With its tag, as it stands.
    whole: &'a [u8],
}

fn fields(message: &[u8]) -> Option<Vec<Field<'_>>> {
    let mut all = Vec::new();
    let mut rest = message;
    while !rest.is_empty() {
        let begin = rest;
        let tag = varint(&mut rest)?;
        let payload = match tag & 7 {
            0 => {
                varint(&mut rest)?;
                None
            }
            1 => rest.split_off(..8).map(|_| None)?,
            2 => {
                let length = usize::try_from(varint(&mut rest)?).ok()?;
                Some(rest.split_off(..length)?)
            }
            5 => rest.split_off(..4).map(|_| None)?,
            _ => return None,
        };
        all.push(Field { number: tag >> 3, payload, whole: &begin[..begin.len() - rest.len()] });
    }
    Some(all)
}

/// The first text of this number; `None` when there is none, or the message is none.
fn text(message: &[u8], number: u64) -> Option<&str> {
    let all = fields(message)?;
    let payload = all.iter().find(|field| field.number == number)?.payload?;
    std::str::from_utf8(payload).ok()
}

fn varint(rest: &mut &[u8]) -> Option<u64> {
    let mut value = 0_u64;
    for shift in (0..64).step_by(7) {
        let byte = *rest.split_off_first()?;
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}

fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn put_number(out: &mut Vec<u8>, number: u64, value: u64) {
    put_varint(out, number << 3);
    put_varint(out, value);
}

fn put(out: &mut Vec<u8>, number: u64, payload: &[u8]) {
    put_varint(out, number << 3 | 2);
    put_varint(out, payload.len() as u64);
    out.extend_from_slice(payload);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_whole_numbers_stays_as_it_is() {
        let model = include_bytes!("../tests/data/two-boxes.onnx");
        assert_eq!(in_floats(model).as_deref(), Some(&model[..]));
        assert_eq!(in_floats(&model[..model.len() / 2]), None);
        assert_eq!(in_floats(b"no model"), None);
        assert_eq!(in_floats(&[]), Some(Vec::new()));
    }

    #[test]
    fn a_convolution_of_bytes_becomes_one_of_floats() {
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
