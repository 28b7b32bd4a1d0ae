//! ONNX files as bytes: the necessary changes to a file before it is run.

#[cfg(feature = "rten")]
mod exact;
#[cfg_attr(not(feature = "rten"), allow(dead_code, reason = "rten's graphs are changed before they are run"))]
mod nodes;
#[cfg(feature = "rten")]
mod one_channel;
#[cfg(feature = "onnxruntime")]
mod outputs;
#[cfg_attr(not(feature = "rten"), allow(dead_code, reason = "rten's graphs are changed before they are run"))]
mod protobuf;

#[cfg(feature = "rten")]
pub(crate) use exact::exact;
#[cfg(feature = "onnxruntime")]
pub(crate) use outputs::with_outputs;
