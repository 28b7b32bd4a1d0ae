//! The device: the frames of a session sealed in order, with simulated orientation errors.

use rand::SeedableRng;
use rand_chacha::{ChaCha8Rng, ChaCha20Rng};
use veiloc_datasets::problem_files::seed_for;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_obfuscation::audit::{SealTruth, options_for};
use veiloc_obfuscation::{Extracted, Orientation, Sealer, Session};
use veiloc_synthetic::problems::normal;

use super::Condition;
use super::recording::{DeviceFrame, Recording};

/// One sealed frame: the sent query, and data for the evaluation only.
pub(super) struct Sealed {
    pub(super) bytes: Vec<u8>,
    pub(super) truth: SealTruth,
}

/// The frames of one session in order.
pub(super) struct SealedSession {
    /// Each sealed, or the cause of failure.
    pub(super) frames: Vec<Result<Sealed, String>>,
    /// Number of new layout positions.
    pub(super) starts: u32,
}

impl Recording<'_> {
    /// Seals frames in one session. The first orientation is exact, since all others are relative to it. Sessions of all
    /// schemes have equal errors.
    pub(super) fn seal(&self, frames: &[DeviceFrame], condition: &Condition) -> SealedSession {
        let (seed, text) = (self.evaluation.scene.seed, condition.scheme.to_string());
        let first = frames.first().map_or("", |f| &f.name);
        let mut key = ChaCha20Rng::seed_from_u64(seed_for(seed, &[first, &text, "session"]));
        let options = self.evaluation.session.with_anchors(condition.anchors).with_max_starts(None);
        let mut session = Session::new(options, &mut key);
        // Anchors are compared: gravity would help the poses of some.
        let options = options_for(condition.scheme).without_gravity();
        let options = match &self.place {
            Some((place, usage)) => options.with_place(place.clone(), *usage),
            None => options,
        };
        let sealer = Sealer::new(self.map_file().profile(), options);
        let orientations = self.orientations(frames, condition);
        let sealed = frames.iter().zip(orientations).map(|(frame, orientation)| {
            let orientation = orientation.ok_or("the pose is no rotation")?;
            let mut rng = ChaCha20Rng::seed_from_u64(seed_for(seed, &[&frame.name, &text]));
            let sealer = sealer.as_ref().map_err(|e| e.to_string())?;
            let extracted =
                Extracted::new(frame.features.clone(), frame.camera).with_orientation(orientation);
            let sealed = sealer.in_session(&mut session).seal_with_truth(extracted, &mut rng);
            sealed.map(|(query, truth)| Sealed { bytes: query.encode(), truth }).map_err(|e| e.to_string())
        });
        let frames = sealed.collect();
        SealedSession { frames, starts: session.starts() }
    }

    /// Orientations with simulated errors; `None` for a pose that is no rotation.
    fn orientations(&self, frames: &[DeviceFrame], condition: &Condition) -> Vec<Option<Orientation>> {
        let down = Vector3::from(self.gravity.down().in_world());
        let mut drift = Rotation3::identity();
        let orientation = |(k, frame): (usize, &DeviceFrame)| {
            let seed = seed_for(self.evaluation.scene.seed, &[&frame.name, "gyroscope"]);
            let mut errors = ChaCha8Rng::seed_from_u64(seed);
            let mut turn = |sd_deg: f64| {
                let angles = Vector3::from_fn(|_, _| sd_deg.to_radians() * normal(&mut errors));
                Rotation3::from_scaled_axis(if k == 0 { Vector3::zeros() } else { angles })
            };
            let own = turn(condition.gyro_deg);
            drift = turn(condition.drift_deg) * drift;
            let rotation = frame.cam_from_world.rotation();
            let held = Orientation::in_world(own * drift * rotation)?;
            held.with_down((rotation * down).into())
        };
        frames.iter().enumerate().map(orientation).collect()
    }
}
