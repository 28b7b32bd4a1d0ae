//! Final refinement of a rig: all poses together, each frame at the noise that its own matches show.

use veiloc_geometry::CameraFromWorld;

use super::frame::Frame;
use super::joint::{Poses, descend};
use super::odometry::OdometryConstraint;
use crate::likelihood::{Loss, System, linearize};
use crate::options::PoseOptions;
use crate::ransac::search::{FINAL_GAIN, FINAL_STEPS, NOISE_RANGE, POLISH_ROUNDS, ROUND_STEPS};

/// Pseudo-count of matches with the rig's common noise that is added to each frame: a few agreeing matches do not
/// determine their noise.
const COMMON_NOISE_MATCHES: f64 = 20.0;

/// Poses after the final refinement.
pub(super) struct PolishedRig {
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
) -> PolishedRig {
    polish_with_priors(true, frames, constraints, start, options)
}

/// The same; `known` selects whether the camera priors are included.
pub(super) fn polish_with_priors(
    known: bool,
    frames: &[Frame<'_>],
    constraints: &[OdometryConstraint],
    start: &Poses,
    options: &PoseOptions,
) -> PolishedRig {
    let kernel = |i: usize| frames[i].search.kernel();
    let with_prior_terms = |i: usize, cam: &CameraFromWorld, system: System| {
        if known { frames[i].with_prior_terms(cam, system) } else { system }
    };
    let loss =
        |i: usize, cam: &CameraFromWorld| if known { frames[i].search.priors().loss(cam) } else { 0.0 };
    let assumed = options.noise_px;
    let mut poses = start.clone();
    let mut noise = vec![assumed; frames.len()];
    for _ in 0..POLISH_ROUNDS {
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
        (0..frames.len()).map(|i| frames[i].search.possible(&poses.cams[i], noise[i])).collect();
    let objective = |i: usize, cam: &CameraFromWorld| {
        let likelihood = Loss::Likelihood { noise: noise[i] };
        with_prior_terms(i, cam, linearize(frames[i].search.matches(), &active[i], likelihood, cam))
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
    PolishedRig { poses: if accepted { poses } else { start.clone() }, noise, accepted }
}

/// The noise that each frame's matches show, shrunk towards the common noise of all.
fn shown(frames: &[Frame<'_>], poses: &Poses, noise: &[f64], assumed: f64) -> Vec<f64> {
    let own: Vec<(f64, f64)> = frames
        .iter()
        .zip(&poses.cams)
        .zip(noise)
        .map(|((frame, cam), noise)| {
            let kernel = frame.search.kernel();
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
        variance.sqrt().clamp(NOISE_RANGE[0] * assumed, NOISE_RANGE[1] * assumed)
    };
    own.iter().map(of).collect()
}
