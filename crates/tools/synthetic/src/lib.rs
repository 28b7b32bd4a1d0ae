//! Internal: rendered scenes and geometric problems with ground truth.
//!
//! [`RenderedRoom`] is a furnished room that is generated and rendered from a seed: for a camera pose and intrinsics it
//! returns an image with the true depth of every pixel. Nothing is read from disk, no texture repeats on another
//! surface, and equal seeds give equal bytes for any number of threads.
//!
//! [`problems`] generates sets of 2D–3D matches without images, for tests and benches of solvers.
//!
//! ```
//! use veiloc_geometry::Intrinsics;
//! use veiloc_synthetic::{PathOptions, RenderedRoom, RenderOptions};
//!
//! let room = RenderedRoom::generate(7);
//! let path = room.camera_path(&PathOptions::default());
//! let camera: Intrinsics = "PINHOLE,160,120,131,131,80,60".parse()?;
//! let view = room.render(&path.queries[0], &camera, &RenderOptions::default());
//! assert_eq!(view.rgb().dimensions(), (160, 120));
//! assert!(view.depth(80, 60).is_some_and(|z| z > 0.1));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod builder;
mod bvh;
mod colour;
mod furniture;
mod light;
mod material;
mod noise;
mod painter;
mod panorama;
mod path;
mod print;
pub mod problems;
mod render;
mod room;
mod scene;

pub use path::{CameraPath, PathOptions};
pub use render::{RenderOptions, Rendering};
pub use scene::RenderedRoom;
