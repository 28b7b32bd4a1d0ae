//! A walk of a phone through a map: the poses of its AR framework, which drifts, and answers with known errors.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_ar::{ArWorld, CameraFromAr};
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Rigid3, frames::World};
use veiloc_protocol::{Answer, AnswerDoubt, AnswerPose, AnswerTimes, DoubtKind, GravityUse, MapCoordinates};

/// One frame of the walk.
pub(crate) struct Frame {
    pub(crate) cam_from_ar: CameraFromAr,
    /// The true pose, map units.
    pub(crate) cam_from_map: CameraFromWorld,
}

pub(crate) struct Walk {
    /// At the start; drift changes it slowly.
    pub(crate) ar_from_map: Rigid3<ArWorld, World>,
    pub(crate) frames: Vec<Frame>,
    pub(crate) rng: ChaCha8Rng,
}

/// Standard deviations of an answer: radians and map units.
pub(crate) const SDS: [f64; 6] = [0.004, 0.004, 0.004, 0.02, 0.03, 0.05];

pub(crate) fn normal(rng: &mut impl Rng) -> f64 {
    let (u, v): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
    (-2.0 * u.ln()).sqrt() * (v * std::f64::consts::TAU).cos()
}

impl Walk {
    /// `count` frames, half a metre apart, in a map 40 m from its origin. `drift`: of the AR framework, per metre.
    pub(crate) fn new(count: usize, drift: f64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let turn = Rotation3::from_scaled_axis(Vector3::new(1.5, 0.3, -0.2));
        let ar_from_map = Rigid3::new(turn, turn * Vector3::new(-40.0, 3.0, 12.0));
        let mut here = Vector3::zeros();
        let mut drifted = Vector3::zeros();
        let mut frames = Vec::new();
        for i in 0..count {
            let heading = f64::from(i as u32) * 0.11;
            let step = 0.5 * Vector3::new(heading.sin(), 0.0, -heading.cos());
            here += step;
            drifted += step + 0.5 * drift * Vector3::from_fn(|_, _| normal(&mut rng));
            // The camera looks ahead, with COLMAP's axes: y down.
            let axes = Rotation3::from_scaled_axis(Vector3::x() * std::f64::consts::PI);
            let ar_from_cam = Rotation3::from_scaled_axis(Vector3::y() * -heading) * axes;
            let in_ar = Rigid3::<ArWorld, veiloc_geometry::frames::Camera>::new(ar_from_cam, drifted);
            let truth = Rigid3::<ArWorld, veiloc_geometry::frames::Camera>::new(ar_from_cam, here);
            frames.push(Frame {
                cam_from_ar: in_ar.inverse(),
                cam_from_map: truth.inverse().compose(&ar_from_map),
            });
        }
        Self { ar_from_map, frames, rng }
    }

    /// An answer to frame `i` whose error has the covariance that it states.
    pub(crate) fn answer(&mut self, i: usize) -> Answer {
        let step = SDS.map(|sd| sd * normal(&mut self.rng));
        answer(&self.frames[i].cam_from_map.perturbed(&step), true)
    }

    /// A wrong answer that is as sure of itself as a right one: metres away and turned.
    pub(crate) fn wrong_answer(&mut self, i: usize, trusted: bool) -> Answer {
        let step = [0.3, 0.3, 0.3, 3.0, 3.0, 3.0].map(|sd| sd * normal(&mut self.rng));
        answer(&self.frames[i].cam_from_map.perturbed(&step), trusted)
    }
}

pub(crate) fn answer(pose: &CameraFromWorld, trusted: bool) -> Answer {
    let covariance: [[f64; 6]; 6] =
        std::array::from_fn(|i| std::array::from_fn(|j| if i == j { SDS[i] * SDS[i] } else { 0.0 }));
    let doubt = AnswerDoubt { kind: DoubtKind::WeakEvidence, text: "few matches agree".to_owned() };
    Answer {
        pose: Some(AnswerPose {
            rotation: pose.quaternion(),
            translation: (*pose.translation()).into(),
            covariance,
        }),
        doubts: if trusted { Vec::new() } else { vec![doubt] },
        log_evidence: 100.0,
        margin: f64::INFINITY,
        fit: None,
        gravity: GravityUse::NotProvided,
        map: MapCoordinates { metres_per_unit: Some(1.0), down: None },
        inliers: 100,
        matches: 200,
        hypotheses: 10,
        times: AnswerTimes::default(),
    }
}
