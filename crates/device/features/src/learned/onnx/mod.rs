//! ONNX files as bytes: the graphs that are made here of weights alone, and what must change in a file before it is run.

mod exact;
mod graph;
mod nodes;
mod one_channel;
#[cfg(feature = "onnxruntime")]
mod outputs;
mod protobuf;

pub(crate) use exact::exact;
pub(crate) use graph::{Graph, Padding};
#[cfg(feature = "onnxruntime")]
pub(crate) use outputs::with_outputs;
