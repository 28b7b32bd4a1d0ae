//! Gradient and Gauss–Newton matrix of the soft likelihood `−Σ log(1 + exp llr)`, for Levenberg–Marquardt.
//!
//! With `right = 1 / (1 + exp(−llr))`, the probability that a correspondence is right, the loss has the gradient `Σ
//! right · (6 k / (1 + k e²) · e · J − ∂ log r)` and, without the derivatives of `right`, the matrix `Σ right · 6 k /
//! (1 + k e²) · Jᵀ J`. `J` is the derivative by the six numbers of a small motion of the camera frame, `p ↦ p + ω × p +
//! v`: rotation `ω`, then translation `v`.

use super::layout::{Block, Group, LANES, Lanes, MAX_DEPTH, ObservationType, PoseLanes};
use crate::approx::{exp_of_negative, ln};
use crate::backend::{Backend, Kind};

/// A camera: rows of `[R | t]`, and the focal lengths in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraRows {
    /// Rotation and translation.
    pub rows: [[f32; 4]; 3],
    /// `f_x`, `f_y`.
    pub focal: [f32; 2],
}

/// The soft likelihood at one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalEquations {
    /// `−Σ log(1 + exp llr)`.
    pub loss: f64,
    /// Its gradient.
    pub gradient: [f64; 6],
    /// Its Gauss–Newton matrix, symmetric.
    pub hessian: [[f64; 6]; 6],
    /// `Σ right`: number of correspondences that agree.
    pub agreeing: f64,
    /// `Σ right · e² · 6 / (1 + k e²)`: with `Σ right` it gives the next scale of the residuals.
    pub spread: f64,
}

const PAIRS: usize = 21;

/// Running sums, one per lane.
struct Sums {
    loss: Lanes,
    agreeing: Lanes,
    spread: Lanes,
    gradient: [Lanes; 6],
    hessian: [Lanes; PAIRS],
}

impl PoseLanes {
    /// The soft likelihood with its derivatives; `k` and `shift` as in [`PoseLanes::likelihood`].
    pub fn normal_equations(
        &self,
        backend: Backend,
        camera: &CameraRows,
        k: f32,
        shift: f32,
    ) -> NormalEquations {
        match backend.kind() {
            Kind::Portable => choose(self, camera, k, shift),
            // SAFETY: the backend's value proves that the CPU has these features (see `Backend`).
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => unsafe { avx2(self, camera, k, shift) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512Vnni => unsafe { avx512(self, camera, k, shift) },
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn avx2(lanes: &PoseLanes, camera: &CameraRows, k: f32, shift: f32) -> NormalEquations {
    choose(lanes, camera, k, shift)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn avx512(lanes: &PoseLanes, camera: &CameraRows, k: f32, shift: f32) -> NormalEquations {
    choose(lanes, camera, k, shift)
}

const POINTS: u8 = 0;
const LINES: u8 = 1;
const ANCHORED: u8 = 2;
/// Anchored, with a second family of sectors.
const CROSSED: u8 = 3;

#[inline(always)]
fn choose(lanes: &PoseLanes, camera: &CameraRows, k: f32, shift: f32) -> NormalEquations {
    match lanes.observed {
        ObservationType::Points => equations::<POINTS>(lanes, camera, k, shift),
        ObservationType::Lines => equations::<LINES>(lanes, camera, k, shift),
        ObservationType::Anchored if lanes.crossed() => equations::<CROSSED>(lanes, camera, k, shift),
        ObservationType::Anchored => equations::<ANCHORED>(lanes, camera, k, shift),
    }
}

#[inline(always)]
fn equations<const OBSERVED: u8>(
    lanes: &PoseLanes,
    camera: &CameraRows,
    k: f32,
    shift: f32,
) -> NormalEquations {
    let zero = [0.0_f32; LANES];
    let mut sums =
        Sums { loss: zero, agreeing: zero, spread: zero, gradient: [zero; 6], hessian: [zero; PAIRS] };
    for group in &lanes.groups {
        for block in &group.blocks {
            let mut first = [zero; 6];
            let mut second = [zero; 6];
            let mut weights = Weights { residual: [zero; 2], radial: zero, weight: zero };
            for l in 0..LANES {
                lane::<OBSERVED>(
                    (lanes, group, block),
                    camera,
                    (k, shift),
                    l,
                    &mut first,
                    &mut second,
                    &mut weights,
                    &mut sums,
                );
            }
            add::<OBSERVED>(&first, &second, &weights, &mut sums);
        }
    }
    finish(&sums)
}

/// For one block: residuals, the weight of their squares, and the weight of `−log r`.
struct Weights {
    residual: [Lanes; 2],
    radial: Lanes,
    weight: Lanes,
}

/// Residuals, weights and Jacobians of one lane. For points `second` is the Jacobian of the second residual; for
/// anchored lines it is the Jacobian of `log r`.
#[inline(always)]
#[expect(clippy::needless_bitwise_bool, reason = "`&&` is a branch, and branches stop vectorization")]
#[expect(clippy::too_many_arguments, reason = "one loop body, cut out for reading")]
fn lane<const OBSERVED: u8>(
    (lanes, group, block): (&PoseLanes, &Group, &Block),
    camera: &CameraRows,
    (k, shift): (f32, f32),
    l: usize,
    first: &mut [Lanes; 6],
    second: &mut [Lanes; 6],
    weights: &mut Weights,
    sums: &mut Sums,
) {
    let (px, py, pz) = (block.x[l], block.y[l], block.z[l]);
    let row = |r: &[f32; 4]| r[0] * px + r[1] * py + r[2] * pz + r[3];
    let (x, y, z) = (row(&camera.rows[0]), row(&camera.rows[1]), row(&camera.rows[2]));
    let [fx, fy] = camera.focal;
    let inverse = 1.0 / z;
    let (u, v) = (fx * x * inverse, fy * y * inverse);
    let mut visible = (z > 0.0) & (z < MAX_DEPTH) & lanes.image.holds(u, v);
    let (e0, e1) = if OBSERVED == POINTS {
        (u - block.a[l], v - block.b[l])
    } else {
        (block.a[l] * u + block.b[l] * v + block.c[l], 0.0)
    };
    let squared = e0 * e0 + e1 * e1;
    let (mut du, mut dv, mut radius) = (0.0, 0.0, 1.0);
    if OBSERVED >= ANCHORED {
        let [x, y, w] = group.anchor;
        (du, dv) = (w * u - x, w * v - y);
        radius = du * du + dv * dv;
        visible &= match &lanes.partition {
            Some(partition) if OBSERVED == CROSSED => partition.admits::<true>(group.index, u, v),
            Some(partition) => partition.admits::<false>(group.index, u, v),
            None => true,
        };
        visible &= radius > 1e-6;
    }
    let s = 1.0 + k * squared;
    let cube = s * s * s;
    let llr = block.score_offset[l] + shift + 0.5 * ln(radius / (cube * cube));
    let small = exp_of_negative(-llr.abs());
    let softplus = (if llr > 0.0 { llr } else { 0.0 }) + ln(1.0 + small);
    let right = (if llr > 0.0 { 1.0 } else { small }) / (1.0 + small);
    // Zero for unobservable points: selected, not multiplied, to keep infinities out.
    let pick = |value: f32| if visible { value } else { 0.0 };
    let weight = pick(right * 6.0 * k / s);
    sums.loss[l] -= pick(softplus);
    sums.agreeing[l] += pick(right);
    sums.spread[l] += pick(right * squared * 6.0 / s);
    weights.weight[l] = weight;
    weights.residual[0][l] = pick(e0);
    weights.residual[1][l] = pick(e1);
    let (x, y, z) = (pick(x), pick(y), pick(z));
    let chart = |j: &mut [Lanes; 6], gx: f32, gy: f32, gz: f32| {
        j[0][l] = y * gz - z * gy;
        j[1][l] = z * gx - x * gz;
        j[2][l] = x * gy - y * gx;
        j[3][l] = gx;
        j[4][l] = gy;
        j[5][l] = gz;
    };
    let (ux, uz) = (pick(fx * inverse), pick(-u * inverse));
    let (vy, vz) = (pick(fy * inverse), pick(-v * inverse));
    if OBSERVED == POINTS {
        chart(first, ux, 0.0, uz);
        chart(second, 0.0, vy, vz);
    } else {
        let (a, b) = (block.a[l], block.b[l]);
        chart(first, a * ux, b * vy, a * uz + b * vz);
    }
    if OBSERVED >= ANCHORED {
        let w = group.anchor[2];
        let (ru, rv) = (pick(w * du / radius), pick(w * dv / radius));
        chart(second, ru * ux, rv * vy, ru * uz + rv * vz);
        weights.radial[l] = pick(right);
    }
}

/// Adds one block to the sums.
#[inline(always)]
fn add<const OBSERVED: u8>(first: &[Lanes; 6], second: &[Lanes; 6], weights: &Weights, sums: &mut Sums) {
    let mut pair = 0;
    for i in 0..6 {
        let mut scaled = [[0.0_f32; LANES]; 2];
        for l in 0..LANES {
            scaled[0][l] = weights.weight[l] * first[i][l];
            sums.gradient[i][l] += scaled[0][l] * weights.residual[0][l];
            if OBSERVED == POINTS {
                scaled[1][l] = weights.weight[l] * second[i][l];
                sums.gradient[i][l] += scaled[1][l] * weights.residual[1][l];
            }
            if OBSERVED >= ANCHORED {
                sums.gradient[i][l] -= weights.radial[l] * second[i][l];
            }
        }
        for j in i..6 {
            for l in 0..LANES {
                let mut product = scaled[0][l] * first[j][l];
                if OBSERVED == POINTS {
                    product += scaled[1][l] * second[j][l];
                }
                sums.hessian[pair][l] += product;
            }
            pair += 1;
        }
    }
}

fn finish(sums: &Sums) -> NormalEquations {
    let total = |lanes: &Lanes| lanes.iter().map(|x| f64::from(*x)).sum::<f64>();
    let mut hessian = [[0.0; 6]; 6];
    let mut pair = 0;
    for i in 0..6 {
        for j in i..6 {
            hessian[i][j] = total(&sums.hessian[pair]);
            hessian[j][i] = hessian[i][j];
            pair += 1;
        }
    }
    NormalEquations {
        loss: total(&sums.loss),
        gradient: std::array::from_fn(|i| total(&sums.gradient[i])),
        hessian,
        agreeing: total(&sums.agreeing),
        spread: total(&sums.spread),
    }
}
