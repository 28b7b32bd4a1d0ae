//! Internal: obfuscation schemes and sealing, the only code that turns keypoints into lines.
//!
//! No other crate sees both a keypoint's position and the line that is sent for it. It runs on the device. [`Sealer`]
//! is the entry point; `docs/reference/privacy-rules.md` lists each privacy rule with its test.
//!
//! [`SealOptions`] decide how positions are hidden; they belong to the device. A [`Profile`](veiloc_protocol::Profile)
//! says what to extract, and is followed only within [`DeviceLimits`].
//!
//! ```
//! use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
//! use veiloc_features::{Features, Keypoint};
//! use veiloc_geometry::{Intrinsics, Pixel};
//! use veiloc_obfuscation::{Extracted, SealOptions, Sealer, device_rng};
//!
//! // On a device the profile comes from the map's server, and features with their camera from `Sealer::extract`.
//! let kind = DescriptorKind::ROOT_SIFT;
//! let words = Descriptors::new(kind, vec![20; 2 * 128])?;
//! let profile = veiloc_protocol::Profile::vlad(Vocabulary::new(words)?);
//! let pixel = |i: u32| Pixel::new(f64::from(20 + i * 97 % 600), f64::from(20 + i * 61 % 440));
//! let keypoints = (0..300).map(|i| Keypoint { pixel: pixel(i), scale: 2.0, orientation: 0.0, response: 1.0 });
//! let bytes = (0..300 * 128_u32).map(|i| (i * 31 % 90) as u8).collect();
//! let features = Features { keypoints: keypoints.collect(), descriptors: Descriptors::new(kind, bytes)?, global: None };
//!
//! let camera: Intrinsics = "SIMPLE_RADIAL,640,480,525,320,240,-0.01".parse()?;
//! let sealer = Sealer::new(&profile, SealOptions::default())?;
//! let sealed = sealer.seal(Extracted::new(features, camera), &mut device_rng()?)?;
//! assert_eq!((sealed.scheme().to_string(), sealed.len()), ("dcl".to_owned(), 256));
//! let bytes = sealed.encode(); // send these; send the same bytes again when the network fails
//! # assert!(!bytes.is_empty());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Cargo features
//! - `ground-truth` (off): obfuscation that also returns the ground truth, for attacks and evaluation. No device needs
//!   it, and a program for devices must not enable it; `docs/reference/privacy-rules.md` explains how to check this.
#![forbid(unsafe_code)]

#[cfg(feature = "ground-truth")]
pub mod audit;
mod camera;
mod decoy;
mod error;
mod grid;
mod options;
mod pack;
mod positions;
mod rng;
mod rule;
mod schemes;
mod seal;
mod sealer;
mod session;

#[cfg(feature = "ground-truth")]
#[doc(inline)]
pub use audit::{SealTruth, obfuscate_points};
pub use camera::KnownCamera;
pub use error::{SealError, SealErrorKind};
pub use options::{DeviceLimits, SealOptions};
pub use pack::{ExplainedRow, KnownPlace, PackUse, UnknownPackUse};
pub use rng::device_rng;
pub use sealer::{Extracted, Sealer, SessionSealer};
pub use session::{Orientation, Session, SessionAnchors, SessionAnchorsError, SessionOptions};
