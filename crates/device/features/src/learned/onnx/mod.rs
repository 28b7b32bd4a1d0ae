//! ONNX files as bytes: the graphs that are made here of weights alone, and what must change in a file before it is run.

#[cfg(feature = "rten")]
mod exact;
mod graph;
#[cfg_attr(
    not(feature = "rten"),
    expect(dead_code, reason = "the engine changes graphs before it runs them")
)]
mod nodes;
#[cfg(feature = "rten")]
mod one_channel;
#[cfg(feature = "onnxruntime")]
mod outputs;
mod protobuf;

#[cfg(feature = "rten")]
pub(crate) use exact::exact;
pub(crate) use graph::{Graph, Padding};
#[cfg(feature = "onnxruntime")]
pub(crate) use outputs::with_outputs;
