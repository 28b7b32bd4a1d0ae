//! Learned features: user-provided networks, and the extraction of local and global features from their outputs.
//!
//! ```text
//! image ── prepared: size, mirrored margin, normalization ── network ── scores ── peaks ── descriptors ── features
//! ```
//!
//! - [`Models`]: the known models, with their sources and search folders.
//! - [`Description`]: a model described by a text file; any ONNX network that matches one is an extractor.
//! - [`Learned`]: a described network as an [`Extractor`](crate::Extractor).
//! - [`GlobalDescription`], [`LearnedGlobal`]: the same for one vector per image
//!   ([`GlobalExtractor`](crate::GlobalExtractor)).
//! - [`Network`]: an ONNX file, run by an [`Engine`]: rten (pure Rust), or the user's ONNX Runtime (cargo feature
//!   `onnxruntime`).
//!
//! No network is part of the project, and none is downloaded; `scripts/export_onnx.py` makes ONNX files from the
//! authors' weights. A device that uses SIFT needs no engine.
#![forbid(unsafe_code)]

mod built_in;
mod description;
mod engine;
mod extractor;
mod file;
mod global;
mod head;
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
pub use models::{GlobalModelFiles, ModelFile, Models};
pub use network::Network;
pub use tensor::Tensor;
