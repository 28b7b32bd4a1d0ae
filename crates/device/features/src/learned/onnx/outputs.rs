//! Inner layers of a model as additional outputs.

use super::nodes::GRAPH;
use super::protobuf::{Field, fields, put};

/// `GraphProto.output`.
const GRAPH_OUTPUT: u64 = 12;
/// `ValueInfoProto.name`.
const NAME: u64 = 1;

/// The model with these layers as outputs after its own; `None` when the bytes are not a protocol buffer.
///
/// The added outputs have no type: engines infer it from the graph.
pub(crate) fn with_outputs(model: &[u8], layers: &[String]) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(model.len());
    for field in fields(model)? {
        match field {
            Field { number: GRAPH, payload: Some(graph), .. } => {
                let mut graph = graph.to_vec();
                for layer in layers {
                    let mut value = Vec::new();
                    put(&mut value, NAME, layer.as_bytes());
                    put(&mut graph, GRAPH_OUTPUT, &value);
                }
                put(&mut out, GRAPH, &graph);
            }
            field => out.extend_from_slice(field.whole),
        }
    }
    Some(out)
}
