//! Camera poses over many correspondences: scores and normal equations, in single precision, sixteen lanes at a time.
//!
//! - [`PoseLanes`]: correspondences as arrays of sixteen per quantity, in groups that share an anchor.
//! - [`PoseLanes::truncated`], [`PoseLanes::likelihood`]: how well a pose explains them.
//! - [`PoseLanes::normal_equations`]: the likelihood with its gradient and Gauss–Newton matrix.
//! - [`RadialLanes`]: a pose whose depth along one ray is not known yet, scored by angles about that ray.
//!
//! The loops over lanes have no branches and no calls, so the compiler vectorizes them; the same source is compiled
//! once for each [`crate::Backend`]. Multiplications and additions are never fused and lanes are summed in a fixed
//! order, so every backend gives the same bits. The caller defines the meaning of the numbers: here a correspondence is
//! a point `x y z`, an observation `a b c` and a `score_offset`.
//!
//! # Computation
//! With `p = R x + t`, `u = f_x p_x / p_z`, `v = f_y p_y / p_z` (pixels from the principal point):
//!
//! | observed | squared residual `e²` | `r²` |
//! |---|---|---|
//! | points | `(u − a)² + (v − b)²` | 1 |
//! | lines | `(a u + b v + c)²` | 1 |
//! | anchored | `(a u + b v + c)²` | squared distance of `(u, v)` from the group's anchor, times any factor |
//!
//! - truncated: `Σ max(0, score_offset − k e²)` over points in front of the camera;
//! - likelihood: `llr = score_offset + shift + ½ log(r² / (1 + k e²)⁶)`, a Student t distribution's logarithm, summed
//!   where it is positive over points that project into the image and, for anchored ones, into a sector of their
//!   group's pencil.

mod layout;
mod normal;
mod radial;
mod score;

pub use layout::{
    Block, Group, Image, LANES, Lanes, ObservationType, Partition, PoseLanes, Sectors, UNUSED_LANE_OFFSET,
};
pub use normal::{CameraRows, NormalEquations};
pub use radial::{RadialBlock, RadialLanes};
pub use score::ScaledRows;
