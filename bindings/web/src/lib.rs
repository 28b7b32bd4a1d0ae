//! The device's road for browsers: what the npm package `veiloc` is built of.
//!
//! It holds no algorithm. A page's worker hands over one message, calls, and reads one reply ([`exports`]); what can be asked is
//! [`request::Request`]. Pixels come in as a canvas has them and become gray by the library's own weights, so that a browser
//! seals what a native program seals.
//!
//! - [`device`]: what is kept between two calls: profiles, sessions, queries.
//! - [`sealing`]: an image to a sealed query, and its beginnings for progressive queries.
//! - [`shown`]: what the query tells and what an attacker makes of it, for the screen of the device and for nobody else.
//!
//! Random numbers are the page's: every request that draws brings 32 bytes of `crypto.getRandomValues`. Equal bytes give equal
//! seals, here and in a native program (`scripts/web/`).
#![deny(unsafe_code)]

pub mod device;
pub mod error;
pub mod exports;
pub mod message;
pub mod request;
pub mod sealing;
pub mod shown;
