//! The device side for C, C++, C# (Unity) and Dart.
//!
//! This crate holds no algorithm: each function checks its pointers, calls the library (`veiloc-ar`,
//! `veiloc-obfuscation`, `veiloc-protocol`) and returns a [`Status`](status::VeilocStatus). It sends nothing: the app
//! sends the bytes with its own HTTP (`docs/reference/http.md`). `include/veiloc.h` is generated from this crate
//! (`cargo xtask c-header`).
//!
//! # Rules of the interface
//! - A handle (`VeilocProfile *`, …) is made by a `_new` function and freed by the `_free` function of its type; null
//!   may be freed. One thread at a time uses a handle; different handles may be used by different threads.
//! - Bytes that a function returns ([`VeilocBytes`](bytes::VeilocBytes)) are freed by `veiloc_bytes_free`. Texts belong
//!   to the library or to their handle, and are not freed.
//! - Pointers that a function only reads are not kept after it returns, frames included.
//! - A function that fails changes nothing, and `veiloc_last_error` says why, on the same thread.
//! - No panic crosses the border: it becomes `VEILOC_STATUS_INTERNAL`.
//!
//! # `unsafe`
//! Only what crosses the border is unsafe: pointers of the caller become references, and back. Each function says what
//! the caller guarantees; `src/pointers.rs` holds all conversions.
#![deny(unsafe_op_in_unsafe_fn)]
#![expect(unsafe_code, reason = "pointers of the caller; `cargo xtask tidy` allows it in this crate")]
#![expect(
    clippy::missing_safety_doc,
    reason = "one contract for all functions: pointers are null or point to what their type says (crate docs)"
)]

pub mod advice;
pub mod alignment;
pub mod anchors;
pub mod answer;
pub mod burst;
pub mod bytes;
pub mod camera;
pub mod cancellation;
pub mod pack;
mod pointers;
pub mod pose;
pub mod profile;
pub mod query;
pub mod sealer;
pub mod session;
pub mod status;
