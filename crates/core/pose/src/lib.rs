//! Internal: robust pose estimation: LO-RANSAC, samplers, and the confidence of the result.
//!
//! [`estimate_pose`] is the entry point. [`ransac`] holds the search loop, generic over the estimated model, with its
//! samplers and scores.
//!
//! | observations | minimal samples | with gravity |
//! |---|---|---|
//! | points | three points, `p3p` | two points, `up2p` |
//! | lines of any direction | six lines, `p6lp` | four lines, `u4lp` |
//! | anchored lines | five lines of one anchor and a vote of the other's ([`AnchoredSolver::RadialVote`]), five and one (`p6lp_dual_radial`), or any six (`p6lp`) | four lines, `u4lp` |
//!
//! Hypotheses are compared by the likelihood of the observations ([`ScoreKind::Likelihood`]; `veiloc_pose::likelihood`
//! defines it by one formula for all three kinds, so that schemes can be compared fairly), optimised locally and
//! refined with the same objective, at the noise that the inliers show. `veiloc_descriptor` gives the probability of each match
//! before geometry is considered. The plain MSAC score, the paper's recipe, has a false optimum on anchored lines, with
//! the scene projected onto an anchor; the likelihood does not.
//!
//! An estimate has a covariance that matches its real errors and a [`Confidence`] that says whether to trust it.
//! Recall, errors and times: `research/notes/pose-engine.md`.
//!
//! # Example
//! A camera at the origin, and sixty keypoints of which the query contains one line each:
//! ```
//! use rand::SeedableRng;
//! use veiloc_geometry::{CameraFromWorld, Pencils, Pinhole, Pixel, Point3};
//! use veiloc_pose::{Correspondences, PoseOptions, PoseProblem, estimate_pose};
//!
//! let camera = Pinhole { width: 640, height: 480, focal: [525.0; 2], principal: [320.0, 240.0] };
//! let pencils = Pencils::paper(640, 480);
//! let pixel = |i: u32| Pixel::new(f64::from(i * 97 % 640) + 0.5, f64::from(i * 53 % 480) + 0.5);
//! let depth = |i: u32| 2.0 + 0.7 * f64::from(i % 5);
//! let line = |p: Pixel| (pencils.anchor_of(p), pencils.angle_of(pencils.anchor_of(p), p));
//! let lines = (0..60).map(|i| line(pixel(i))).collect();
//! let observations = Correspondences::Anchored { pencils, lines };
//! let keypoints = (0..60).collect(); // each has one correspondence
//! let points = (0..60)
//!     .map(|i| Point3::from_vector(camera.unproject(pixel(i)).homogeneous() * depth(i)))
//!     .collect();
//! let problem = PoseProblem::new(camera, observations, keypoints, points);
//! let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
//! let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng)?;
//! assert!(found.cam_from_world.translation_error(&CameraFromWorld::identity()) < 1e-3);
//! assert!(found.inlier_keypoints > 50);
//! # Ok::<(), veiloc_pose::PoseError>(())
//! ```
//!
//! Results depend only on the problem, the options and the given generator.
#![forbid(unsafe_code)]
#![expect(clippy::neg_cmp_op_on_partial_ord, reason = "comparisons are written so that NaN fails")]

mod confidence;
mod error;
mod estimate;
pub mod likelihood;
mod options;
pub mod ransac;
mod rig;
pub mod solvers;

pub use crate::likelihood::{
    Correspondences, FocalPrior, Gravity, MatchViewpoint, PoseProblem, PositionPrior,
};
pub use confidence::{Confidence, Doubt, Precision, State};
pub use error::PoseError;
pub use estimate::cramer_rao::fisher_information;
pub use estimate::pose_estimate::{PoseEstimate, Rival};
pub use estimate::refine_inliers::refine_pose;
pub use estimate::{estimate_pose, estimate_rig_pose, optimize_pose};
pub use options::{AnchoredSolver, PoseOptions, ScoreKind, UnknownScore, UnknownSolver};
pub use ransac::Stop;
pub use rig::{FrameEstimate, RigEstimate, RigFrame};
