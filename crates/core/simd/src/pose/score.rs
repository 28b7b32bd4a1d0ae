//! The score of a pose over all correspondences: the innermost loop of the search.
//!
//! Scores are sums of gains that are never negative, so a pose whose gain so far plus the maximum of the rest stays
//! below `to_beat` is dropped early, without any loss. NaN gains nothing.

use super::layout::{Block, Group, Image, LANES, MAX_DEPTH, ObservationType, PoseLanes};
use crate::approx::ln;
use crate::backend::{Backend, Kind};

/// Blocks between two checks whether the pose can still win.
const BLOCKS_PER_CHECK: usize = 8;

/// Rows of `diag(f_x, f_y, 1) [R | t]`.
pub type ScaledRows = [[f32; 4]; 3];

const POINTS: u8 = 0;
const LINES: u8 = 1;
const ANCHORED: u8 = 2;
/// Anchored, with a second family of sectors.
const CROSSED: u8 = 3;

/// One score of one pose.
#[derive(Clone, Copy)]
struct Task<'a> {
    lanes: &'a PoseLanes,
    rows: &'a ScaledRows,
    k: f32,
    shift: f32,
    to_beat: f32,
}

impl PoseLanes {
    /// `Σ max(0, score_offset − k e²)` over points in front of the camera.
    ///
    /// Stops early, with any value below it, when `to_beat` cannot be reached any more.
    pub fn truncated(&self, backend: Backend, rows: &ScaledRows, k: f32, to_beat: f32) -> f32 {
        run::<false>(backend, Task { lanes: self, rows, k, shift: 0.0, to_beat })
    }

    /// `Σ max(0, llr)` over observable points; see the module for `llr`.
    ///
    /// Stops early, with any value below it, when `to_beat` cannot be reached any more; with a positive `shift`, which
    /// the bound does not include, `to_beat` must be negative infinity.
    pub fn likelihood(&self, backend: Backend, rows: &ScaledRows, k: f32, shift: f32, to_beat: f32) -> f32 {
        run::<true>(backend, Task { lanes: self, rows, k, shift, to_beat })
    }
}

impl PoseLanes {
    /// `llr` of every lane in turn, group by group, `−∞` for unobservable points; `out` is cleared first.
    ///
    /// Unused lanes have an entry too.
    pub fn each_likelihood(
        &self,
        backend: Backend,
        rows: &ScaledRows,
        k: f32,
        shift: f32,
        out: &mut Vec<f32>,
    ) {
        let task = Task { lanes: self, rows, k, shift, to_beat: f32::NEG_INFINITY };
        out.clear();
        match backend.kind() {
            Kind::Portable => choose_each(task, out),
            // SAFETY: the backend's value proves that the CPU has these features (see `Backend`).
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => unsafe { avx2_each(task, out) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512Vnni => unsafe { avx512_each(task, out) },
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn avx2_each(task: Task<'_>, out: &mut Vec<f32>) {
    choose_each(task, out);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn avx512_each(task: Task<'_>, out: &mut Vec<f32>) {
    choose_each(task, out);
}

#[inline(always)]
fn choose_each(task: Task<'_>, out: &mut Vec<f32>) {
    match task.lanes.observed {
        ObservationType::Points => each::<POINTS>(task, out),
        ObservationType::Lines => each::<LINES>(task, out),
        ObservationType::Anchored if task.lanes.crossed() => each::<CROSSED>(task, out),
        ObservationType::Anchored => each::<ANCHORED>(task, out),
    }
}

#[inline(always)]
fn each<const OBSERVED: u8>(task: Task<'_>, out: &mut Vec<f32>) {
    for group in &task.lanes.groups {
        for block in &group.blocks {
            let mut values = [0.0_f32; LANES];
            for (l, value) in values.iter_mut().enumerate() {
                let (llr, visible) = likelihood::<OBSERVED>(&task, group, block, l);
                *value = if visible { llr } else { f32::NEG_INFINITY };
            }
            out.extend_from_slice(&values);
        }
    }
}

fn run<const LIKELIHOOD: bool>(backend: Backend, task: Task<'_>) -> f32 {
    match backend.kind() {
        Kind::Portable => choose::<LIKELIHOOD>(task),
        // SAFETY: the backend's value proves that the CPU has these features (see `Backend`).
        #[cfg(target_arch = "x86_64")]
        Kind::Avx2 => unsafe { avx2::<LIKELIHOOD>(task) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512Vnni => unsafe { avx512::<LIKELIHOOD>(task) },
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn avx2<const LIKELIHOOD: bool>(task: Task<'_>) -> f32 {
    choose::<LIKELIHOOD>(task)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn avx512<const LIKELIHOOD: bool>(task: Task<'_>) -> f32 {
    choose::<LIKELIHOOD>(task)
}

#[inline(always)]
fn choose<const LIKELIHOOD: bool>(task: Task<'_>) -> f32 {
    match task.lanes.observed {
        ObservationType::Points => sum::<POINTS, LIKELIHOOD>(task),
        ObservationType::Lines => sum::<LINES, LIKELIHOOD>(task),
        ObservationType::Anchored if task.lanes.crossed() => sum::<CROSSED, LIKELIHOOD>(task),
        ObservationType::Anchored => sum::<ANCHORED, LIKELIHOOD>(task),
    }
}

#[inline(always)]
fn sum<const OBSERVED: u8, const LIKELIHOOD: bool>(task: Task<'_>) -> f32 {
    let mut total = 0.0_f32;
    let mut rest: f32 = task.lanes.groups.iter().map(|g| g.most[0]).sum();
    for group in &task.lanes.groups {
        rest -= group.most[0];
        for (look, blocks) in group.blocks.chunks(BLOCKS_PER_CHECK).enumerate() {
            let mut sums = [0.0_f32; LANES];
            for block in blocks {
                for l in 0..LANES {
                    sums[l] += gain::<OBSERVED, LIKELIHOOD>(&task, group, block, l);
                }
            }
            total += sums.iter().sum::<f32>();
            let done = look * BLOCKS_PER_CHECK + blocks.len();
            if total + group.most[done] + rest < task.to_beat {
                return total;
            }
        }
    }
    total
}

#[inline(always)]
#[expect(clippy::needless_bitwise_bool, reason = "`&&` is a branch, and branches stop vectorization")]
fn gain<const OBSERVED: u8, const LIKELIHOOD: bool>(
    task: &Task<'_>,
    group: &Group,
    block: &Block,
    l: usize,
) -> f32 {
    if LIKELIHOOD {
        let (llr, visible) = likelihood::<OBSERVED>(task, group, block, l);
        if visible & (llr > 0.0) { llr } else { 0.0 }
    } else {
        let seen = project::<OBSERVED>(task, block, l);
        let gain = block.score_offset[l] - task.k * seen.squared;
        if (seen.z > 0.0) & (gain > 0.0) { gain } else { 0.0 }
    }
}

/// A projection and its squared residual.
struct Projection {
    u: f32,
    v: f32,
    z: f32,
    squared: f32,
}

#[inline(always)]
fn project<const OBSERVED: u8>(task: &Task<'_>, block: &Block, l: usize) -> Projection {
    let (px, py, pz) = (block.x[l], block.y[l], block.z[l]);
    let row = |r: &[f32; 4]| r[0] * px + r[1] * py + r[2] * pz + r[3];
    let (x, y, z) = (row(&task.rows[0]), row(&task.rows[1]), row(&task.rows[2]));
    let inverse = 1.0 / z;
    let (u, v) = (x * inverse, y * inverse);
    let squared = if OBSERVED == POINTS {
        let (du, dv) = (u - block.a[l], v - block.b[l]);
        du * du + dv * dv
    } else {
        let e = block.a[l] * u + block.b[l] * v + block.c[l];
        e * e
    };
    Projection { u, v, z, squared }
}

/// The log likelihood ratio, and whether the point is observable.
#[inline(always)]
#[expect(clippy::needless_bitwise_bool, reason = "`&&` is a branch, and branches stop vectorization")]
fn likelihood<const OBSERVED: u8>(task: &Task<'_>, group: &Group, block: &Block, l: usize) -> (f32, bool) {
    let Projection { u, v, z, squared } = project::<OBSERVED>(task, block, l);
    let image: &Image = &task.lanes.image;
    let mut visible = (z > 0.0) & (z < MAX_DEPTH) & image.holds(u, v);
    let mut radius = 1.0;
    if OBSERVED >= ANCHORED {
        let [x, y, w] = group.anchor;
        let (du, dv) = (w * u - x, w * v - y);
        radius = du * du + dv * dv;
        visible &= match &task.lanes.partition {
            Some(partition) if OBSERVED == CROSSED => partition.admits::<true>(group.index, u, v),
            Some(partition) => partition.admits::<false>(group.index, u, v),
            None => true,
        };
    }
    let s = 1.0 + task.k * squared;
    let cube = s * s * s;
    (block.score_offset[l] + task.shift + 0.5 * ln(radius / (cube * cube)), visible)
}
