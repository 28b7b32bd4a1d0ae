//! Poses without the depth along one ray: scored by the angles about that ray only.
//!
//! In the camera rotated so that the ray is its optical axis, a right correspondence lies in the direction `(u, v)`
//! from the axis. With `(x, y)` the first two coordinates of `R p + t` there, `llr = score_offset − 3 log(1 + k (u y −
//! v x)² / (x² + y²))`, counted when it is positive and `u x + v y > 0`.

use super::layout::{LANES, Lanes, UNUSED_LANE_OFFSET};
use crate::approx::ln;
use crate::backend::{Backend, Kind};

/// Blocks between two checks whether the pose can still win.
const BLOCKS_PER_CHECK: usize = 8;

/// Sixteen correspondences of one anchor.
#[derive(Debug, Clone)]
#[repr(align(64))]
pub struct RadialBlock {
    /// The points, relative to any origin shared with the poses.
    pub x: Lanes,
    /// See `x`.
    pub y: Lanes,
    /// See `x`.
    pub z: Lanes,
    /// Unit directions from the axis.
    pub u: Lanes,
    /// See `u`.
    pub v: Lanes,
    /// The part of the score that does not depend on the pose.
    pub score_offset: Lanes,
}

impl RadialBlock {
    /// All lanes unused.
    pub const EMPTY: Self = Self {
        x: [0.0; LANES],
        y: [0.0; LANES],
        z: [0.0; LANES],
        u: [0.0; LANES],
        v: [0.0; LANES],
        score_offset: [UNUSED_LANE_OFFSET; LANES],
    };
}

/// Correspondences of one anchor, ready for scoring.
#[derive(Debug, Clone)]
pub struct RadialLanes {
    blocks: Vec<RadialBlock>,
    most: Vec<f32>,
}

impl RadialLanes {
    /// Poor poses are dropped soonest when the blocks are sorted by falling `score_offset`.
    pub fn new(blocks: Vec<RadialBlock>) -> Self {
        let mut most = vec![0.0_f32; blocks.len() + 1];
        for (k, block) in blocks.iter().enumerate().rev() {
            most[k] = most[k + 1] + block.score_offset.iter().map(|w| w.max(0.0)).sum::<f32>();
        }
        Self { blocks, most }
    }

    /// `Σ max(0, llr)`; `rows` are the first two of `[R | t]` in the rotated camera.
    ///
    /// Stops early, with any value below it, when `to_beat` cannot be reached any more.
    pub fn score(&self, backend: Backend, rows: &[[f32; 4]; 2], k: f32, to_beat: f32) -> f32 {
        match backend.kind() {
            Kind::Portable => sum(self, rows, k, to_beat),
            // SAFETY: the backend's value proves that the CPU has these features (see `Backend`).
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => unsafe { avx2(self, rows, k, to_beat) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512Vnni => unsafe { avx512(self, rows, k, to_beat) },
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn avx2(lanes: &RadialLanes, rows: &[[f32; 4]; 2], k: f32, to_beat: f32) -> f32 {
    sum(lanes, rows, k, to_beat)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn avx512(lanes: &RadialLanes, rows: &[[f32; 4]; 2], k: f32, to_beat: f32) -> f32 {
    sum(lanes, rows, k, to_beat)
}

#[inline(always)]
#[expect(clippy::needless_bitwise_bool, reason = "`&&` is a branch, and branches stop vectorization")]
fn sum(lanes: &RadialLanes, rows: &[[f32; 4]; 2], k: f32, to_beat: f32) -> f32 {
    let mut total = 0.0_f32;
    for (look, blocks) in lanes.blocks.chunks(BLOCKS_PER_CHECK).enumerate() {
        let mut sums = [0.0_f32; LANES];
        for block in blocks {
            for l in 0..LANES {
                let row = |r: &[f32; 4]| r[0] * block.x[l] + r[1] * block.y[l] + r[2] * block.z[l] + r[3];
                let (x, y) = (row(&rows[0]), row(&rows[1]));
                let across = block.u[l] * y - block.v[l] * x;
                let ahead = block.u[l] * x + block.v[l] * y;
                let s = 1.0 + k * across * across / (x * x + y * y);
                let gain = block.score_offset[l] - 3.0 * ln(s);
                sums[l] += if (ahead > 0.0) & (gain > 0.0) { gain } else { 0.0 };
            }
        }
        total += sums.iter().sum::<f32>();
        let done = look * BLOCKS_PER_CHECK + blocks.len();
        if total + lanes.most[done] < to_beat {
            return total;
        }
    }
    total
}
