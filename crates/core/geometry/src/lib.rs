//! Internal: frames, camera models, poses and 2D lines.
//!
//! The base of all other crates; it does no I/O, uses no random numbers, and also builds for wasm.
//!
//! # Conventions
//! - Poses are world-to-camera, `x_cam = R x_world + t`, and are named `cam_from_world`.
//! - Pixels follow COLMAP: the centre of the first pixel is (0.5, 0.5), `u` to the right, `v` down.
//! - Camera axes: `x` right, `y` down, `z` forward. A point is in front of the camera when its depth `z > 0`.
//! - A 2D line is homogeneous with unit normal, so that its product with a point is a signed distance.
#![forbid(unsafe_code)]

mod camera_model;
pub mod deviations;
mod distortion;
pub mod frames;
mod geodetic;
mod intrinsics;
mod line;
mod panorama;
pub mod pencils;
mod pixel;
mod quarter_turns;
pub mod statistics;
mod stop;

pub use camera_model::{CameraModel, IntrinsicsError};
pub use frames::{CameraFromRig, CameraFromWorld, Point3, RigFromWorld, Rigid3, rotation_to_z};
pub use geodetic::Geodetic;
pub use intrinsics::{Intrinsics, Pinhole};
pub use line::{PixelLine, PlaneLine};
pub use panorama::{Panorama, PanoramaFace};
pub use pencils::{Anchor, AnchorPosition, Arc, Layout, PencilLine, Pencils, PlacedSectors, Sectors, Span};
pub use pixel::{Pixel, PlanePoint};
pub use quarter_turns::QuarterTurns;
pub use stop::Stop;

/// The linear algebra library of the types of this crate, so that callers use the same version.
pub use nalgebra;
