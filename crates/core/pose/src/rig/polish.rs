//! Final refinement: all poses together, each frame at the noise that its own matches show.

use veiloc_geometry::CameraFromWorld;

use super::frame::Frame;
use super::joint::{Poses, descend};
use super::odometry::OdometryConstraint;
use crate::likelihood::{Loss, System, linearize};
use crate::options::PoseOptions;

/// Rounds of refinement and noise estimation.
const ROUNDS: usize = 12;

/// Steps of one round.
const ROUND_STEPS: usize = 3;

/// Allowed range of the noise, in multiples of the assumed one.
const NOISE_RANGE: [f64; 2] = [0.05, 1.5];

/// Steps of the last refinement, in double precision.
pub(crate) const FINAL_STEPS: usize = 25;

/// A step of the last refinement that gains less than this share ends it.
const FINAL_GAIN: f64 = 1e-9;

/// Pseudo-count of matches with the rig's common noise that is added to each frame: a few agreeing matches do not
/// determine their noise.
const COMMON_NOISE_MATCHES: f64 = 20.0;

/// Poses after the final refinement.
#[derive(Clone)]
pub(super) struct Polished {
    pub(super) poses: Poses,
    /// Scale of the noise that each frame's inliers show, pixels, `[F]`.
    pub(super) noise: Vec<f64>,
    /// Whether the refinement was accepted.
    pub(super) accepted: bool,
}

/// Refines from `start`; accepted only when it does not make the refined objective worse. The frames' matches are
/// restricted to what the start can see.
pub(super) fn polish(
    frames: &[Frame<'_>],
    constraints: &[OdometryConstraint],
    start: &Poses,
    options: &PoseOptions,
) -> Polished {
    polish_with_priors(true, frames, constraints, start, options)
}

/// The same; `known` selects whether the camera priors are included.
pub(super) fn polish_with_priors(
    known: bool,
    frames: &[Frame<'_>],
    constraints: &[OdometryConstraint],
    start: &Poses,
    options: &PoseOptions,
) -> Polished {
    let kernel = |i: usize| frames[i].kernel();
    let with_prior_terms = |i: usize, cam: &CameraFromWorld, system: System| {
        if known { frames[i].with_prior_terms(cam, system) } else { system }
    };
    let loss = |i: usize, cam: &CameraFromWorld| if known { frames[i].priors().loss(cam) } else { 0.0 };
    let assumed = options.noise_px;
    let mut poses = start.clone();
    let mut noise = vec![assumed; frames.len()];
    for _ in 0..ROUNDS {
        let objective =
            |i: usize, cam: &CameraFromWorld| with_prior_terms(i, cam, kernel(i).linearize(cam, noise[i]).0);
        poses = descend(constraints, objective, &poses, ROUND_STEPS, 1e-7);
        if !options.estimate_noise {
            break;
        }
        let next = shown(frames, &poses, &noise, assumed);
        let settled = noise.iter().zip(&next).all(|(old, new)| (new / old - 1.0).abs() < 0.02);
        noise = next;
        if settled {
            break;
        }
    }
    let active: Vec<Vec<usize>> =
        (0..frames.len()).map(|i| frames[i].possible(&poses.cams[i], noise[i])).collect();
    let objective = |i: usize, cam: &CameraFromWorld| {
        let likelihood = Loss::Likelihood { noise: noise[i] };
        with_prior_terms(i, cam, linearize(frames[i].matches(), &active[i], likelihood, cam))
    };
    poses = descend(constraints, objective, &poses, FINAL_STEPS, FINAL_GAIN);
    let cost = |poses: &Poses| {
        let of = |i: usize| {
            let cam = &poses.cams[i];
            kernel(i).cost_at(cam, noise[i]) + loss(i, cam)
        };
        poses.odometry_loss(constraints) + (0..frames.len()).map(of).sum::<f64>()
    };
    let accepted = cost(&poses) <= cost(start);
    Polished { poses: if accepted { poses } else { start.clone() }, noise, accepted }
}

/// The noise that each frame's matches show, shrunk towards the common noise of all.
fn shown(frames: &[Frame<'_>], poses: &Poses, noise: &[f64], assumed: f64) -> Vec<f64> {
    let range = [NOISE_RANGE[0] * assumed, NOISE_RANGE[1] * assumed];
    if let ([frame], [cam], [noise]) = (frames, poses.cams.as_slice(), noise) {
        return vec![frame.kernel().linearize(cam, *noise).1.clamp(range[0], range[1])];
    }
    let own: Vec<(f64, f64)> = frames
        .iter()
        .zip(&poses.cams)
        .zip(noise)
        .map(|((frame, cam), noise)| {
            let kernel = frame.kernel();
            let agreeing: f64 =
                kernel.likelihoods(cam, *noise).into_iter().map(|llr| 1.0 / (1.0 + (-llr).exp())).sum();
            (kernel.linearize(cam, *noise).1.powi(2), agreeing)
        })
        .collect();
    let total: f64 = own.iter().map(|(_, agreeing)| agreeing).sum();
    let common = own.iter().map(|(variance, agreeing)| variance * agreeing).sum::<f64>() / total;
    let of = |(variance, agreeing): &(f64, f64)| {
        let variance = if common.is_finite() {
            (variance * agreeing + common * COMMON_NOISE_MATCHES) / (agreeing + COMMON_NOISE_MATCHES)
        } else {
            *variance
        };
        variance.sqrt().clamp(range[0], range[1])
    };
    own.iter().map(of).collect()
}
