//! Convolutions with one output channel, computed as the first of two channels.
//!
//! rten 0.24 multiplies a matrix of one row in as many pieces as there are threads, and rounds the columns at the end
//! of a piece differently: the same image had different scores with two threads than with one. Matrices of two or more
//! rows are summed equally for all divisions (`tests/oracle.rs`, `any_number_of_threads_gives_the_same_features`).
//! Products with vectors (`MatMul`, `Gemm`) of one row are not changed; no known local feature has one.

use std::collections::BTreeSet;

use super::nodes::{ATTRIBUTE, INITIALIZER, INPUT, OUTPUT, number, numbers, operator};
use super::protobuf::{Field, fields, text, varints};

const ZERO: &str = "veiloc:zero";
const ONE: &str = "veiloc:one";

/// Names of the graph's tensors `[1, C, k, k]`.
pub(super) fn kernels(graph: &[Field<'_>]) -> BTreeSet<String> {
    named(graph, |first| first == 1)
}

/// Names of the graph's four-dimensional tensors whose first side satisfies `such`.
pub(super) fn named(graph: &[Field<'_>], such: impl Fn(u64) -> bool) -> BTreeSet<String> {
    let of = |field: &Field<'_>| {
        let tensor = field.payload.filter(|_| field.number == INITIALIZER)?;
        such(first_side(tensor)?).then(|| text(tensor, 8).map(str::to_owned))?
    };
    graph.iter().filter_map(of).collect()
}

/// The first side of a four-dimensional tensor (`dims` 1), packed or one by one.
fn first_side(tensor: &[u8]) -> Option<u64> {
    let mut sides = Vec::new();
    for field in fields(tensor)?.iter().filter(|field| field.number == 1) {
        match field.payload {
            Some(packed) => sides.extend(varints(packed)?),
            None => sides.push(field.value?),
        }
    }
    (sides.len() == 4).then(|| sides[0])
}

/// The nodes that replace one `Conv` with such a kernel; `None` for any other.
pub(super) fn first_of_two(node: &[u8], kernels: &BTreeSet<String>) -> Option<Vec<Vec<u8>>> {
    let all = fields(node)?;
    let texts = |number: u64| {
        let of = all.iter().filter(move |field| field.number == number);
        of.map(|field| std::str::from_utf8(field.payload?).ok()).collect::<Option<Vec<&str>>>()
    };
    let (inputs, outputs) = (texts(INPUT)?, texts(OUTPUT)?);
    let (&[image, kernel], output) = (inputs.first_chunk()?, *outputs.first()?);
    if !kernels.contains(kernel) {
        return None;
    }
    let name = |what: &str| format!("veiloc:{output}:{what}");
    let mut nodes = vec![operator("Concat", &[kernel, kernel], &name("kernels"), &[number("axis", 0)])];
    let (kernels, biases, both) = (name("kernels"), name("biases"), name("both"));
    let mut twice = vec![image, &kernels];
    if let Some(bias) = inputs.get(2).filter(|bias| !bias.is_empty()) {
        nodes.push(operator("Concat", &[bias, bias], &biases, &[number("axis", 0)]));
        twice.push(&biases);
    }
    let attributes: Option<Vec<Vec<u8>>> = (all.iter())
        .filter(|field| field.number == ATTRIBUTE)
        .map(|field| field.payload.map(<[u8]>::to_vec))
        .collect();
    nodes.push(operator("Conv", &twice, &both, &attributes?));
    nodes.push(operator("Slice", &[&both, ZERO, ONE, ONE], output, &[]));
    Some(nodes)
}

/// Start, end and axis of the slice that selects the first channel.
pub(super) fn ends() -> [Vec<u8>; 2] {
    [numbers(ZERO, &[0]), numbers(ONE, &[1])]
}
