//! Minimal solvers for absolute pose and the polynomial roots they need.
//!
//! | solver | sample | solutions | source |
//! |---|---|---|---|
//! | [`p3p`] | three points | 0–4 | Persson and Nordberg 2018; Ding et al. 2023 |
//! | [`p5lp_radial`] | five half-lines from one image point | 0–4, up to the depth along that point's ray | Kukelova et al. 2013 |
//! | [`p6lp`] | six line–point pairs | 0–8 | Speciale et al. 2019; Kukelova et al. 2016 |
//! | [`p6lp_dual_radial`] | five half-planes of one anchor, one of another | 0–4 | `p5lp_radial`, then one linear equation |
//! | [`up2p`] | two points and the vertical | 0–2 | Kukelova et al. 2010 |
//! | [`u4lp`] | four line–point pairs and the vertical | 0–2 | Speciale et al. 2019 |
//!
//! Names follow PoseLib: how many 2D-point–3D-point (`p`) and 2D-line–3D-point (`lp`) constraints a sample has,
//! and `u` for upright: the vertical is known ([`GravityAlignment`]).
//! Runtimes: `cargo bench -p veiloc-benches --bench solvers`; a comparison with PoseLib: `docs/results/poses.md`.
//! Every solver is deterministic, allocates nothing, never panics, and returns no poses for a degenerate or non-finite
//! sample: that is not an error, RANSAC draws again.
//!
//! # Example
//! ```
//! use veiloc_geometry::{CameraFromWorld, Point3};
//! use veiloc_pose::solvers::{ArrayVec, p3p};
//!
//! let truth = CameraFromWorld::from_quaternion([0.9, 0.1, -0.2, 0.3], [0.2, -0.1, 0.5]).expect("finite");
//! let points = [Point3::new(0.0, 0.0, 4.0), Point3::new(1.0, 0.0, 5.0), Point3::new(0.0, 1.0, 6.0)];
//! let bearings = points.map(|point| truth.transform(&point).coords.normalize());
//!
//! let mut poses = ArrayVec::new();
//! p3p(&bearings, &points, &mut poses);
//! assert!(poses.iter().any(|pose| pose.translation_error(&truth) < 1e-6));
//! ```
#![forbid(unsafe_code)]
#![expect(clippy::neg_cmp_op_on_partial_ord, reason = "comparisons are written so that NaN fails")]

mod conics;
mod gravity;
mod half_plane;
mod p3p;
mod p5lp_radial;
mod p6lp;
mod p6lp_dual_radial;
pub mod polynomial;
mod quadrics;
mod u4lp;
mod up2p;

/// The buffer for solutions.
pub use arrayvec::ArrayVec;
pub use gravity::GravityAlignment;
pub use half_plane::HalfPlane;
pub use p3p::p3p;
pub use p5lp_radial::{RadialPose, p5lp_radial};
pub use p6lp::p6lp;
pub use p6lp_dual_radial::p6lp_dual_radial;
pub use u4lp::u4lp;
pub use up2p::up2p;
