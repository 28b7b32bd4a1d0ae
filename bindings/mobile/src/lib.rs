//! The device side for Kotlin and Swift, whose sources UniFFI generates from this crate.
//!
//! This crate holds no algorithm: each method converts its arguments, calls the library (`veiloc-ar`,
//! `veiloc-obfuscation`, `veiloc-protocol`) and returns, or throws a [`VeilocException`](error::VeilocException). It
//! sends nothing: the app sends the bytes with OkHttp or URLSession (`docs/reference/http.md`).
//!
//! - Objects may be used from any thread. `Sealer.extract` takes tens of milliseconds: call it on a background thread. No method
//!   calls back into the app.
//! - The bytes of a frame are not copied: in Kotlin they are a direct `ByteBuffer`, as Android's `Image.Plane` has one.
//! - In Kotlin, objects are `AutoCloseable`: close them, or the garbage collector frees them later.
//!
//! `bindings/mobile/generate.sh` writes the sources.
#![forbid(unsafe_code)]
#![expect(
    clippy::needless_pass_by_value,
    reason = "records cross the border by value, whether or not a method keeps them"
)]

pub mod advice;
pub mod alignment;
pub mod anchors;
pub mod answer;
pub mod burst;
pub mod camera;
pub mod cancellation;
pub mod error;
pub mod pack;
pub mod pose;
pub mod profile;
pub mod query;
pub mod sealer;
pub mod session;

uniffi::setup_scaffolding!();
