//! Sessions: a random rig, frames on it, and their odometry.

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromRig, RigFromWorld, Rigid3};
use veiloc_pose::{PoseProblem, RigFrame};

use crate::support::{Setup, gauss, seen_from};

/// Standard deviations of the odometry, degrees and map units: about as much as the frames' own poses.
pub(crate) const ODOMETRY: [f64; 2] = [0.02, 0.001];

/// A random rig and the true poses of its frames on it: rotated by up to 10°, moved by up to half a map unit.
pub(crate) fn rig(frames: usize, rng: &mut ChaCha8Rng) -> (RigFromWorld, Vec<CameraFromRig>) {
    let turn = |rng: &mut ChaCha8Rng, a: f64| {
        Rotation3::from_scaled_axis(Vector3::from_fn(|_, _| rng.random_range(-a..a)))
    };
    let shift = |rng: &mut ChaCha8Rng, a: f64| Vector3::from_fn(|_, _| rng.random_range(-a..a));
    let truth = Rigid3::new(turn(rng, 2.0), shift(rng, 5.0));
    (truth, (0..frames).map(|_| Rigid3::new(turn(rng, 0.1), shift(rng, 0.5))).collect())
}

/// The frame with noisy odometry.
pub(crate) fn measured(
    problem: PoseProblem,
    truth: &CameraFromRig,
    sd: [f64; 2],
    rng: &mut ChaCha8Rng,
) -> RigFrame {
    let turn = Rotation3::from_scaled_axis(Vector3::from_fn(|_, _| sd[0].to_radians() * gauss(rng)));
    let shift = Vector3::from_fn(|_, _| sd[1] * gauss(rng));
    let cam_from_rig = Rigid3::new(turn * truth.rotation(), turn * truth.translation() + shift);
    RigFrame { problem, cam_from_rig, rotation_sd_deg: sd[0], translation_sd: sd[1] }
}

/// A session of similar frames, and the true pose of its rig, to which the first frame is fixed.
pub(crate) fn session(
    setup: &Setup,
    frames: usize,
    sd: [f64; 2],
    rng: &mut ChaCha8Rng,
) -> (Vec<RigFrame>, RigFromWorld) {
    let (truth, on_rig) = rig(frames, rng);
    let frame = |(i, on_rig): (usize, &CameraFromRig)| {
        let problem = seen_from(&on_rig.compose(&truth), setup, rng);
        measured(problem, on_rig, if i == 0 { [0.0; 2] } else { sd }, rng)
    };
    (on_rig.iter().enumerate().map(frame).collect(), truth)
}
