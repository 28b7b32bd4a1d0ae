//! Simulated gravity of a device: the true direction in its camera, with the noise of an accelerometer.

use std::fmt;
use std::str::FromStr;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Rotation3, Unit, Vector3};
use veiloc_map::{GravityDirection, PosedImages};
use veiloc_protocol::CoarseGravity;
use veiloc_synthetic::problems::normal;

use crate::error::EvalError;
use crate::pose::mean_down;

/// Errors of simulated sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GravityNoise {
    /// Standard deviation about each axis across the direction, degrees; the queries state it.
    pub sd_deg: f64,
    /// Angle by which each measurement is rotated too, degrees, about a random axis across it: of devices that accelerate,
    /// or lie.
    pub wrong_by_deg: f64,
}

impl FromStr for GravityNoise {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (sd, wrong) = text.split_once('/').unwrap_or((text, "0"));
        let refuse = || {
            format!(
                "{text:?}: expected a deviation above 0, or a deviation and an error, as in 0.5 or 0.5/90"
            )
        };
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|n| n.is_finite() && *n >= 0.0);
        let (sd_deg, wrong_by_deg) = number(sd).zip(number(wrong)).ok_or_else(refuse)?;
        if sd_deg > 0.0 && wrong_by_deg <= 180.0 { Ok(Self { sd_deg, wrong_by_deg }) } else { Err(refuse()) }
    }
}

impl fmt::Display for GravityNoise {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.sd_deg)?;
        if self.wrong_by_deg > 0.0 { write!(f, "/{}", self.wrong_by_deg) } else { Ok(()) }
    }
}

/// A world with a vertical, and sensors with these errors.
#[derive(Debug, Clone, Copy)]
pub struct SimulatedGravity {
    down: GravityDirection,
    noise: GravityNoise,
}

impl SimulatedGravity {
    /// Down is the mean of the map images' own down axes. It need not be the true vertical: map and queries use the
    /// same direction, and any direction is sufficient.
    ///
    /// # Errors
    /// [`EvalError::Options`] for a deviation that a query cannot encode.
    pub fn of(posed: &PosedImages, map_list: &[String], noise: GravityNoise) -> Result<Self, EvalError> {
        let refused = |e: &dyn fmt::Display| EvalError::Options(format!("gravity: {e}"));
        let poses = map_list.iter().filter_map(|name| posed.get(name)).map(|image| &image.cam_from_world);
        let down = GravityDirection::new(mean_down(poses).into()).map_err(|e| refused(&e))?;
        CoarseGravity::new(down.in_world(), noise.sd_deg).map_err(|e| refused(&e))?;
        Ok(Self { down, noise })
    }

    /// The down direction of the map.
    pub const fn down(&self) -> GravityDirection {
        self.down
    }

    /// The gravity that the device sends with a query; equal seeds and names give equal noise.
    pub(crate) fn measured(
        &self,
        name: &str,
        cam_from_world: &CameraFromWorld,
        seed: u64,
    ) -> Option<CoarseGravity> {
        let exact = cam_from_world.rotation() * Vector3::from(self.down.in_world());
        let mut rng = ChaCha8Rng::seed_from_u64(seed_for(seed, &[name, "gravity"]));
        // A rotation about the direction itself has no effect: what remains is the noise about the two orthogonal
        // axes.
        let turn = Vector3::from_fn(|_, _| self.noise.sd_deg.to_radians() * normal(&mut rng));
        let axis = Unit::new_normalize(exact.cross(&Vector3::from_fn(|_, _| normal(&mut rng))));
        let wrong = Rotation3::from_axis_angle(&axis, self.noise.wrong_by_deg.to_radians());
        let with_noise = Rotation3::from_scaled_axis(turn) * (wrong * exact);
        CoarseGravity::new(with_noise.into(), self.noise.sd_deg).ok()
    }

    /// A direction that has nothing to do with the query, with this stated deviation.
    pub(crate) fn random(name: &str, sd_deg: f64, seed: u64) -> Option<CoarseGravity> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed_for(seed, &[name, "random gravity"]));
        CoarseGravity::new([0; 3].map(|_| normal(&mut rng)), sd_deg).ok()
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
            noise: GravityNoise { sd_deg: 4.0, wrong_by_deg: 0.0 },
        };
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let n = 2000;
        let mut sum = 0.0;
        for i in 0..n {
            let (name, truth) = (format!("{i}.jpg"), random_pose(&mut rng));
            let gravity = gravity_source.measured(&name, &truth, 7).expect("encodable");
            assert_eq!(gravity_source.measured(&name, &truth, 7), Some(gravity), "equal seeds, equal noise");
            let exact = truth.rotation() * Vector3::from(gravity_source.down.in_world());
            sum += exact.angle(&Vector3::from(gravity.in_camera())).to_degrees().powi(2) / 2.0;
        }
        let about_each = (sum / n as f64).sqrt();
        assert!((about_each - 4.0).abs() < 0.2, "{about_each}");
    }

    #[test]
    fn errors_of_sensors_are_read_and_simulated() {
        for (text, sd_deg, wrong_by_deg) in [("0.5", 0.5, 0.0), ("1/90", 1.0, 90.0)] {
            let noise: GravityNoise = text.parse().expect(text);
            assert_eq!((noise, noise.to_string().as_str()), (GravityNoise { sd_deg, wrong_by_deg }, text));
        }
        for text in ["", "0", "-1", "nan", "0.5/-1", "0.5/181", "1/2/3"] {
            assert!(text.parse::<GravityNoise>().is_err(), "{text:?}");
        }
        let down = GravityDirection::new([0.3, -0.2, 0.9]).expect("a direction");
        let source = SimulatedGravity { down, noise: GravityNoise { sd_deg: 0.01, wrong_by_deg: 30.0 } };
        let truth = random_pose(&mut ChaCha8Rng::seed_from_u64(3));
        let exact = truth.rotation() * Vector3::from(down.in_world());
        let measured = source.measured("a", &truth, 1).expect("encodable").in_camera();
        // Sent rounded to about a degree.
        assert!((exact.angle(&Vector3::from(measured)).to_degrees() - 30.0).abs() < 1.5);
    }

    #[test]
    fn unencodable_deviation_is_refused() {
        for sd_deg in [0.0, -1.0, 17.0, f64::NAN] {
            let noise = GravityNoise { sd_deg, wrong_by_deg: 0.0 };
            let refused = SimulatedGravity::of(&PosedImages::default(), &[], noise);
            assert!(matches!(refused, Err(EvalError::Options(_))), "{sd_deg}");
        }
    }
}
