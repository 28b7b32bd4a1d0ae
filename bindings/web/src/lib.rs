//! The device side for browsers, as WebAssembly: the npm package `veiloc`.
//!
//! This crate holds no algorithm. The page's worker writes one message, calls, and reads one reply ([`exports`]); the
//! calls are [`request::Request`]. Pixels arrive as a canvas stores them, and the library converts them to gray, so that
//! a browser and a native program seal the same bytes.
//!
//! - [`device`]: the state between calls: profiles, sessions, queries.
//! - [`sealing`]: seals an image, and cuts the query into steps for progressive localization.
//! - [`alignment`]: the map in the AR world of WebXR.
//! - [`inspection`]: the content of a query and the result of attacks on it, only for the screen of the device.
//!
//! The page supplies the randomness: each request that needs it carries 32 bytes of `crypto.getRandomValues`. Equal
//! bytes give equal queries, here and in a native program (`scripts/web/`).
#![deny(unsafe_code)]

pub mod alignment;
pub mod device;
pub mod error;
pub mod exports;
pub mod inspection;
pub mod message;
pub mod request;
pub mod sealing;
