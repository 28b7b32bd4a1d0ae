//! Simulated gravity of a device: the true direction in its camera, with the noise of an accelerometer.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_map::{GravityDirection, PosedImages};
use veiloc_protocol::CoarseGravity;
use veiloc_synthetic::problems::normal;

use crate::error::EvalError;
use crate::pose::mean_down;

/// A world with a vertical, and sensors with this noise.
#[derive(Debug, Clone, Copy)]
pub struct SimulatedGravity {
    down: GravityDirection,
    sd_deg: f64,
}

impl SimulatedGravity {
    /// Down is the mean of the map images' own down axes. It need not be the true vertical: map and queries use the
    /// same direction, and any direction is sufficient.
    ///
    /// # Errors
    /// [`EvalError::Options`] for a deviation that a query cannot encode.
    pub fn of(posed: &PosedImages, map_list: &[String], sd_deg: f64) -> Result<Self, EvalError> {
        let refused = |e: &dyn std::fmt::Display| EvalError::Options(format!("gravity: {e}"));
        let poses = map_list.iter().filter_map(|name| posed.get(name)).map(|image| &image.cam_from_world);
        let down = GravityDirection::new(mean_down(poses).into()).map_err(|e| refused(&e))?;
        CoarseGravity::new(down.in_world(), sd_deg).map_err(|e| refused(&e))?;
        Ok(Self { down, sd_deg })
    }

    /// The down direction of the map.
    pub const fn down(&self) -> GravityDirection {
        self.down
    }

    /// Standard deviation about each axis across the direction, degrees.
    pub const fn sd_deg(&self) -> f64 {
        self.sd_deg
    }

    /// The gravity that the device sends with a query; equal seeds and names give equal noise.
    fn measured(&self, name: &str, cam_from_world: &CameraFromWorld, seed: u64) -> Option<CoarseGravity> {
        let exact = cam_from_world.rotation() * Vector3::from(self.down.in_world());
        let mut rng = ChaCha8Rng::seed_from_u64(seed_for(seed, &[name, "gravity"]));
        // A rotation about the direction itself has no effect: what remains is the noise about the two orthogonal
        // axes.
        let turn = Vector3::from_fn(|_, _| self.sd_deg.to_radians() * normal(&mut rng));
        let with_noise = Rotation3::from_scaled_axis(turn) * exact;
        CoarseGravity::new(with_noise.into(), self.sd_deg).ok()
    }

    /// The variants of a query: without gravity, and then with gravity if it is simulated and the pose is known.
    pub(crate) fn variants(
        simulated: Option<&Self>,
        name: &str,
        truth: Option<&CameraFromWorld>,
        seed: u64,
    ) -> impl Iterator<Item = Option<CoarseGravity>> {
        let measured =
            simulated.zip(truth).map(|(gravity_source, truth)| gravity_source.measured(name, truth, seed));
        std::iter::once(None).chain(measured)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_synthetic::problems::random_pose;

    #[test]
    fn noise_has_stated_deviation() {
        let gravity_source = SimulatedGravity {
            down: GravityDirection::new([0.3, -0.2, 0.9]).expect("a direction"),
            sd_deg: 4.0,
        };
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let n = 2000;
        let mut sum = 0.0;
        for i in 0..n {
            let (name, truth) = (format!("{i}.jpg"), random_pose(&mut rng));
            let measured: Vec<_> =
                SimulatedGravity::variants(Some(&gravity_source), &name, Some(&truth), 7).collect();
            let [None, Some(gravity)] = measured[..] else { panic!("nothing, then gravity") };
            assert_eq!(gravity_source.measured(&name, &truth, 7), Some(gravity), "equal seeds, equal noise");
            let exact = truth.rotation() * Vector3::from(gravity_source.down.in_world());
            sum += exact.angle(&Vector3::from(gravity.in_camera())).to_degrees().powi(2) / 2.0;
            assert_eq!(SimulatedGravity::variants(None, &name, Some(&truth), 7).collect::<Vec<_>>(), [None]);
        }
        let about_each = (sum / n as f64).sqrt();
        assert!((about_each - 4.0).abs() < 0.2, "{about_each}");
    }

    #[test]
    fn unencodable_deviation_is_refused() {
        for sd_deg in [0.0, -1.0, 17.0, f64::NAN] {
            let refused = SimulatedGravity::of(&PosedImages::default(), &[], sd_deg);
            assert!(matches!(refused, Err(EvalError::Options(_))), "{sd_deg}");
        }
    }
}
