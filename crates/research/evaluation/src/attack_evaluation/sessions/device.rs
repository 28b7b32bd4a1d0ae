//! The device: the frames of a session sealed in order, with simulated orientation errors.

use crate::pipeline::SimulatedGravity;
use rand::SeedableRng;
use rand_chacha::{ChaCha8Rng, ChaCha20Rng};
use veiloc_datasets::problem_files::seed_for;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_map::MapFile;
use veiloc_obfuscation::audit::{SealTruth, options_for};
use veiloc_obfuscation::{Orientation, Session, SessionAnchors};
use veiloc_protocol::Scheme;
use veiloc_synthetic::problems::normal;

use super::SessionsEvaluation;
use super::frames::DeviceFrame;

/// Errors of orientations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Gyroscope {
    /// Standard deviation of each frame's own error about each axis, degrees.
    pub(super) gyro_deg: f64,
    /// Standard deviation of the drift's step from one frame to the next, degrees.
    pub(super) drift_deg: f64,
}

impl Gyroscope {
    pub(super) const EXACT: Self = Self { gyro_deg: 0.0, drift_deg: 0.0 };
}

/// One sealed frame: the sent query, and data for the evaluation only.
pub(super) struct Sealed {
    pub(super) bytes: Vec<u8>,
    pub(super) truth: SealTruth,
}

/// The frames of one session in order, each sealed or with the cause of failure; and the number of new layout
/// positions.
///
/// The first orientation is exact, since all others are relative to it. Sessions of all schemes have equal errors.
pub(super) fn sealed_in_session(
    frames: &[DeviceFrame],
    scheme: Scheme,
    anchors: SessionAnchors,
    gyroscope: &Gyroscope,
    evaluation: &SessionsEvaluation,
    map: &MapFile,
    gravity_source: &SimulatedGravity,
) -> (Vec<Result<Sealed, String>>, u32) {
    let seed = evaluation.scene.seed;
    let first = frames.first().map_or("", |f| &f.name);
    let text = scheme.to_string();
    let mut key = ChaCha20Rng::seed_from_u64(seed_for(seed, &[first, &text, "session"]));
    let options = evaluation.session.with_anchors(anchors).with_max_starts(None);
    let mut session = Session::new(options, &mut key);
    let mut drift = Rotation3::identity();
    let down = Vector3::from(gravity_source.down().in_world());
    // Anchors are compared: gravity would help the poses of some.
    let seal = options_for(scheme).without_gravity();
    let sealed = frames
        .iter()
        .enumerate()
        .map(|(k, frame)| {
            let mut errors = ChaCha8Rng::seed_from_u64(seed_for(seed, &[&frame.name, "gyroscope"]));
            let mut turn = |sd_deg: f64| {
                let angles = Vector3::from_fn(|_, _| sd_deg.to_radians() * normal(&mut errors));
                Rotation3::from_scaled_axis(if k == 0 { Vector3::zeros() } else { angles })
            };
            let own = turn(gyroscope.gyro_deg);
            drift = turn(gyroscope.drift_deg) * drift;
            let rotation = frame.cam_from_world.rotation();
            let held = Orientation::in_world(own * drift * rotation)
                .and_then(|held| held.with_down((rotation * down).into()))
                .ok_or("the pose is no rotation")?;
            let mut rng = ChaCha20Rng::seed_from_u64(seed_for(seed, &[&frame.name, &text]));
            let features = frame.features.clone();
            let sealed =
                session.seal_with_truth(features, &frame.camera, map.profile(), &seal, &held, &mut rng);
            sealed.map(|(query, truth)| Sealed { bytes: query.encode(), truth }).map_err(|e| e.to_string())
        })
        .collect();
    (sealed, session.starts())
}
