//! Learned features: networks that users bring, and what makes keypoints and descriptors, local and global, of their numbers.
//!
//! ```text
//! image ── prepared: size, mirror image around it, numbers ── network ── scores ── peaks ── descriptors there ── features
//! ```
//!
//! - [`Models`]: the models known by name, where their files are got and where they are looked for.
//! - [`Description`]: a model as a text file says it; any ONNX network that fits one is an extractor.
//! - [`Learned`]: a described network as an [`Extractor`](crate::Extractor).
//! - [`GlobalDescription`], [`LearnedGlobal`]: the same for one vector of a whole image ([`GlobalExtractor`](crate::GlobalExtractor)).
//! - [`Network`]: an ONNX file, run by an [`Engine`]: rten (pure Rust), or ONNX Runtime where the
//!   user brings it (cargo feature `onnxruntime`).
//!
//! No network is part of the project, and none is downloaded; `scripts/export_onnx.py` makes ONNX files of their authors' weights. This room runs on the device and where maps are built; `features`
//! does without it, so that a device that uses SIFT needs no engine.
#![forbid(unsafe_code)]

mod built_in;
mod description;
mod engine;
mod extractor;
mod file;
mod global;
mod keypoints;
mod layer;
mod models;
mod network;
mod onnx;
mod prepare;
mod projected;
mod sample;
mod tensor;

pub use description::Description;
pub use engine::Engine;
pub use extractor::Learned;
pub use global::{GlobalDescription, LearnedGlobal};
pub use layer::Layer;
pub use models::{Found, FoundGlobal, Models};
pub use network::Network;
pub use tensor::Tensor;
