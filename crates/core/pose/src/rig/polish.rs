//! Final refinement of a rig: all poses together, each frame at the noise that its own matches show.

use veiloc_geometry::CameraFromWorld;

use super::frame::Frame;
use super::joint::{Poses, descend};
use super::odometry::Tie;
use crate::likelihood::{Loss, System, linearize};
use crate::options::PoseOptions;
use crate::ransac::search::{FINAL_GAIN, FINAL_STEPS, NOISE_RANGE, POLISH_ROUNDS, ROUND_STEPS};

/// So many matches of the rig's noise are added to each frame's own: a few agreeing matches do not tell their noise.
const BORROWED: f64 = 20.0;

/// Poses after the final refinement.
pub(super) struct PolishedRig {
    pub(super) poses: Poses,
    /// Scale of the noise that each frame's inliers show, pixels, `[F]`.
    pub(super) noise: Vec<f64>,
    /// Whether the refinement was kept.
    pub(super) kept: bool,
}

/// Refines from `start`; kept only when it does not make the objective worse that it was refined for. The frames' matches
/// are worth what the start can see of them.
pub(super) fn polish(
    frames: &[Frame<'_>],
    ties: &[Tie],
    start: &Poses,
    options: &PoseOptions,
) -> PolishedRig {
    polish_knowing(true, frames, ties, start, options)
}

/// The same; whether what is known of a camera beside its matches takes part is `known`.
pub(super) fn polish_knowing(
    known: bool,
    frames: &[Frame<'_>],
    ties: &[Tie],
    start: &Poses,
    options: &PoseOptions,
) -> PolishedRig {
    let kernel = |i: usize| frames[i].search.kernel();
    let believed = |i: usize, cam: &CameraFromWorld, system: System| {
        if known { frames[i].believed(cam, system) } else { system }
    };
    let loss =
        |i: usize, cam: &CameraFromWorld| if known { frames[i].search.priors().loss(cam) } else { 0.0 };
    let assumed = options.noise_px;
    let mut poses = start.clone();
    let mut noise = vec![assumed; frames.len()];
    for _ in 0..POLISH_ROUNDS {
        let objective =
            |i: usize, cam: &CameraFromWorld| believed(i, cam, kernel(i).linearize(cam, noise[i]).0);
        poses = descend(ties, objective, &poses, ROUND_STEPS, 1e-7);
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
        believed(i, cam, linearize(frames[i].search.matches(), &active[i], likelihood, cam))
    };
    poses = descend(ties, objective, &poses, FINAL_STEPS, FINAL_GAIN);
    let cost = |poses: &Poses| {
        let of = |i: usize| {
            let cam = &poses.cams[i];
            kernel(i).cost_at(cam, noise[i]) + loss(i, cam)
        };
        poses.tension(ties) + (0..frames.len()).map(of).sum::<f64>()
    };
    let kept = cost(&poses) <= cost(start);
    PolishedRig { poses: if kept { poses } else { start.clone() }, noise, kept }
}

/// The noise that each frame's matches show, drawn towards what all of them show.
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
            (variance * agreeing + common * BORROWED) / (agreeing + BORROWED)
        } else {
            *variance
        };
        variance.sqrt().clamp(NOISE_RANGE[0] * assumed, NOISE_RANGE[1] * assumed)
    };
    own.iter().map(of).collect()
}
