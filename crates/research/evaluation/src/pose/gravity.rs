//! Direction of gravity: from the file, or from the true poses with a simulated accelerometer error.

use std::fmt;
use std::str::FromStr;

use rand::Rng;
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Rotation3, Unit, Vector3};
use veiloc_pose::Gravity;
use veiloc_synthetic::problems::normal;

/// Source of the direction of gravity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GravitySource {
    /// The direction in the problem file, if there is one.
    File,
    /// The estimator gets no gravity.
    Ignored,
    /// The true direction, rotated by this many degrees about a random axis.
    TrueTurned(f64),
}

/// A text that is not a source of gravity.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a source of gravity; write file, none, or an error from 0 to 180 degrees")]
pub struct GravityError(String);

impl FromStr for GravitySource {
    type Err = GravityError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.trim() {
            "file" => Ok(Self::File),
            "none" => Ok(Self::Ignored),
            number => match number.parse::<f64>() {
                Ok(degrees) if (0.0..=180.0).contains(&degrees) => Ok(Self::TrueTurned(degrees)),
                _ => Err(GravityError(text.to_owned())),
            },
        }
    }
}

impl fmt::Display for GravitySource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File => f.pad("file"),
            Self::Ignored => f.pad("none"),
            Self::TrueTurned(degrees) => degrees.fmt(f),
        }
    }
}

/// Down in the world of images held upright: the mean of the cameras' own down axes (`+y`).
///
/// It need not be the true vertical: the estimator gets the same direction in both frames, and any direction is
/// sufficient.
pub fn mean_down<'a>(poses: impl Iterator<Item = &'a CameraFromWorld>) -> Vector3<f64> {
    let sum: Vector3<f64> = poses.map(|pose| pose.rotation().inverse() * Vector3::y()).sum();
    sum.try_normalize(1e-9).unwrap_or(-Vector3::z())
}

/// Smallest stated error of an accelerometer, degrees.
const MIN_SD_DEG: f64 = 0.5;

/// The down direction measured at this true pose by an accelerometer with an error of `degrees`.
pub(crate) fn simulated_reading<R: Rng>(
    truth: &CameraFromWorld,
    down_in_world: Vector3<f64>,
    degrees: f64,
    rng: &mut R,
) -> Gravity {
    let exact = truth.rotation() * down_in_world;
    // The component of a random vector orthogonal to gravity: a rotation axis, uniform over all directions.
    let random = Vector3::from_fn(|_, _| normal(rng));
    let axis = Unit::try_new(exact.cross(&random), 1e-9).unwrap_or_else(|| {
        let (smallest, _) = exact.map(f64::abs).argmin();
        let mut helper = Vector3::zeros();
        helper[smallest] = 1.0;
        Unit::new_normalize(exact.cross(&helper))
    });
    let turn = Rotation3::from_axis_angle(&axis, degrees.to_radians());
    Gravity { in_camera: turn * exact, in_world: down_in_world, sd_deg: degrees.max(MIN_SD_DEG) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use veiloc_synthetic::problems::random_pose;

    #[test]
    fn gravity_sources_round_trip() {
        for text in ["file", "none", "0", "1.5", "180"] {
            assert_eq!(text.parse::<GravitySource>().expect("well written").to_string(), text);
        }
        for text in ["", "-1", "181", "NaN", "down"] {
            assert!(text.parse::<GravitySource>().is_err(), "{text:?}");
        }
    }

    #[test]
    fn gravity_error_has_given_angle_and_uniform_direction() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let truth = random_pose(&mut rng);
        let down = mean_down(std::iter::once(&truth));
        // One upright camera: its own down axis.
        assert!((truth.rotation() * down - Vector3::y()).norm() < 1e-12);
        let mut sideways = Vector3::zeros();
        for _ in 0..400 {
            let simulated_reading = simulated_reading(&truth, down, 3.0, &mut rng);
            assert!(
                (simulated_reading.in_camera.angle(&(truth.rotation() * down)).to_degrees() - 3.0).abs()
                    < 1e-6
            );
            sideways += simulated_reading.in_camera - Vector3::y();
        }
        let most = 3.0_f64.to_radians();
        assert!(sideways.x.hypot(sideways.z) / 400.0 < 0.15 * most, "turned to one side: {sideways}");
        let exact = simulated_reading(&truth, down, 0.0, &mut rng);
        assert!((exact.in_camera - truth.rotation() * down).norm() < 1e-12);
    }
}
