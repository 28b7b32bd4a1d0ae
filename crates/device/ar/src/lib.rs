//! Internal: what an app with an AR framework needs beside sealing, without HTTP: the app sends the bytes itself.
//!
//! - [`orientation_in_world`]: the orientation of the camera in the AR world, with gravity, for a frame
//!   ([`CameraFrame`], an [`Image`](veiloc_features::Image)) that a [`Sealer`](veiloc_obfuscation::Sealer) seals.
//! - [`Burst`]: the sharpest frames of the last second, sealed in a session and localized together.
//! - [`Axes`], [`FrameworkPose`]: poses in the axes and units of ARKit, ARCore, Unity, Unreal and COLMAP.
//! - [`Alignment`]: the transform from the map to the AR world, from several answers, wrong ones among them; it places
//!   anchors, and compares distances in the map with those of the AR framework.
//! - [`Accuracy`]: the radius of 68 % confidence, as ARCore states it.
//! - [`Advice`]: what the user should do, in words.
//!
//! `veiloc-client` has an HTTP client for apps in Rust. The bindings for Kotlin, Swift, C and C# (`bindings/`) wrap this
//! crate and hold no algorithm.
//!
//! # Frames of reference
//! The *AR world* ([`ArWorld`]) is the frame in which the AR framework states the poses of its camera. Here it has the
//! axes of ARKit and ARCore: `x` right, `y` up, `z` back at the start, metres. [`Axes`] converts at the border of this
//! crate, and nothing else knows of other axes.
//!
//! ```
//! use veiloc_ar::{Alignment, Axes, FrameworkPose};
//! use veiloc_protocol::Answer;
//!
//! fn on_answer(alignment: &mut Alignment, answer: &[u8], camera_in_world: &FrameworkPose) -> Option<FrameworkPose> {
//!     // The pose of the camera when it took the frame that was sealed, not its pose now.
//!     let cam_from_ar = Axes::OpenGl.cam_from_ar(camera_in_world)?;
//!     alignment.add(&Answer::decode(answer).ok()?, &cam_from_ar);
//!     // Where content at this place of the map is in the AR world.
//!     let map_from_anchor = FrameworkPose { position: [3.0, 1.2, -0.5], ..FrameworkPose::default() };
//!     alignment.world_from_anchor(Axes::OpenGl, &map_from_anchor)
//! }
//! # let camera = FrameworkPose::default();
//! # assert_eq!(on_answer(&mut Alignment::default(), b"", &camera), None);
//! ```
#![forbid(unsafe_code)]

mod accuracy;
mod advice;
mod alignment;
mod axes;
mod burst;
mod distances;
mod rig;
mod unit;

pub use accuracy::Accuracy;
pub use advice::{Advice, Situation};
pub use alignment::{Aligned, Alignment, AlignmentOptions, AlignmentState, PlacedAnchor, Update};
pub use axes::{ArWorld, Axes, AxesError, CameraFromAr, FrameworkPose};
pub use burst::{Burst, BurstError, BurstOptions, SealedBurst};
pub use distances::{DistanceRatio, DistanceVerdict};
pub use rig::{RigError, orientation_in_world, rig_message, rig_of};
pub use unit::{UnitError, check_unit, metres_per_unit};
pub use veiloc_features::{CameraFrame, FrameMask, MaskKind, PixelFormat};
pub use veiloc_geometry::QuarterTurns;
