//! The gravity direction measured by a device: rounded, so that it reveals the tilt of the device but does not identify
//! its sensor.
//!
//! # The code
//! A direction is projected on the octahedron `|x| + |y| + |z| = 1` and unfolded into the square `[−1, 1]²`; the square
//! is divided into 256 × 256 cells, and a code stands for the middle of its cell. Each cell has one direction, and each
//! direction except those on cell borders has one cell, so the encoding is unique. Cells are 0.8° wide on average, and
//! a direction is at most 1° from the middle of its cell.
//!
//! # Source
//! Meyer et al., *On Floating-Point Normal Vectors*, EGSR 2010.

use std::fmt;
use std::str::FromStr;

use crate::QueryError;

/// Cells along each side of the square.
const CELLS: u32 = 256;
/// Number of encodable standard deviations: `0.5° · 2^k`.
const CLASSES: u32 = 6;
/// The smallest of them, degrees.
const MIN_SD_DEG: f64 = 0.5;

/// The gravity direction in the camera's axes (`x` right, `y` down, `z` forward), rounded to about a degree, and its
/// standard deviation, in classes that double.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct CoarseGravity {
    /// Cells along the square's axes.
    cell: [u8; 2],
    /// `k` of `0.5° · 2^k`.
    class: u8,
}

impl CoarseGravity {
    /// Largest standard deviation that can be encoded, degrees. A less certain direction holds almost no information.
    pub const MAX_SD_DEG: f64 = 16.0;
    /// Default for a phone's accelerometer, degrees.
    pub const PHONE_SD_DEG: f64 = 2.0;
    /// Default for tracking that combines gyroscope and accelerometer (ARKit, ARCore, WebXR, odometry), degrees.
    pub const TRACKING_SD_DEG: f64 = 0.5;

    /// Rounding error about each axis across the direction, root mean square, degrees.
    pub const ROUNDING_SD_DEG: f64 = 0.26;

    /// Rounds a direction. `down`: any length but zero. `sd_deg`: standard deviation about each axis across it,
    /// degrees; encoded as the next larger of 0.5, 1, 2, 4, 8 and 16.
    ///
    /// # Errors
    /// [`QueryError::Gravity`] for a vector without direction, and for a deviation outside of (0, 16].
    pub fn new(down: [f64; 3], sd_deg: f64) -> Result<Self, QueryError> {
        let largest = down.iter().fold(0.0_f64, |m, c| m.max(c.abs()));
        let is_direction = down.iter().all(|c| c.is_finite()) && largest > 0.0;
        if !(is_direction && sd_deg > 0.0 && sd_deg <= Self::MAX_SD_DEG) {
            return Err(QueryError::Gravity);
        }
        let class = (0..CLASSES).find(|k| sd_of(*k) >= sd_deg).unwrap_or(CLASSES - 1);
        // Scaled first, so that sums neither overflow nor underflow.
        let [x, y, z] = down.map(|c| c / largest);
        let norm = x.abs() + y.abs() + z.abs();
        let (x, y) = (x / norm, y / norm);
        let [x, y] = if z < 0.0 { fold([x, y]) } else { [x, y] };
        let cell = |c: f64| (f64::midpoint(c, 1.0) * f64::from(CELLS)).floor().clamp(0.0, 255.0) as u8;
        Ok(Self { cell: [cell(x), cell(y)], class: class as u8 })
    }

    /// Down in the camera's axes, of length 1.
    pub fn in_camera(self) -> [f64; 3] {
        let middle = |cell: u8| (f64::from(cell) + 0.5) / f64::from(CELLS) * 2.0 - 1.0;
        let [x, y] = self.cell.map(middle);
        let z = 1.0 - x.abs() - y.abs();
        let [x, y] = if z < 0.0 { fold([x, y]) } else { [x, y] };
        let norm = (x * x + y * y + z * z).sqrt();
        [x / norm, y / norm, z / norm]
    }

    /// Standard deviation about each axis across it, degrees; the rounding error is small compared to the smallest.
    pub fn sd_deg(self) -> f64 {
        sd_of(self.class.into())
    }

    /// The code on the wire; 0 stands for none.
    pub(crate) fn code(gravity: Option<Self>) -> u32 {
        gravity.map_or(0, |Self { cell: [a, b], class }| {
            1 + (u32::from(class) * CELLS + u32::from(a)) * CELLS + u32::from(b)
        })
    }

    pub(crate) fn from_code(code: u32) -> Result<Option<Self>, QueryError> {
        let Some(code) = code.checked_sub(1) else { return Ok(None) };
        if code >= CLASSES * CELLS * CELLS {
            let (field, value) = ("gravity", code + 1);
            return Err(QueryError::Field { field, value, allowed: "a number from 0 to 393216" });
        }
        let cell = [(code / CELLS % CELLS) as u8, (code % CELLS) as u8];
        Ok(Some(Self { cell, class: (code / CELLS / CELLS) as u8 }))
    }
}

fn sd_of(class: u32) -> f64 {
    MIN_SD_DEG * f64::from(1_u32 << class)
}

/// Maps the lower half of the octahedron around the upper one, and back: its own inverse.
fn fold([x, y]: [f64; 2]) -> [f64; 2] {
    [(1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y)]
}

/// `X,Y,Z` or `X,Y,Z,SD_DEG`; the default deviation is that of a phone.
impl FromStr for CoarseGravity {
    type Err = QueryError;

    fn from_str(text: &str) -> Result<Self, QueryError> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|word| word.trim().parse()).collect();
        match numbers.as_deref() {
            Ok(&[x, y, z]) => Self::new([x, y, z], Self::PHONE_SD_DEG),
            Ok(&[x, y, z, sd]) => Self::new([x, y, z], sd),
            _ => Err(QueryError::Gravity),
        }
    }
}

// The tilt of a device must not appear in logs.
impl fmt::Debug for CoarseGravity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("CoarseGravity")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn angle(a: [f64; 3], b: [f64; 3]) -> f64 {
        let dot: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
        let norm = |v: [f64; 3]| v.iter().map(|c| c * c).sum::<f64>().sqrt();
        (dot / norm(a) / norm(b)).clamp(-1.0, 1.0).acos().to_degrees()
    }

    #[test]
    fn codes_round_trip() {
        assert_eq!(CoarseGravity::from_code(0), Ok(None));
        let mut seen = std::collections::BTreeSet::new();
        for code in 1..=CLASSES * CELLS * CELLS {
            let gravity = CoarseGravity::from_code(code).expect("a code").expect("a direction");
            assert_eq!(CoarseGravity::code(Some(gravity)), code);
            // Its own direction and deviation round to itself.
            let again = CoarseGravity::new(gravity.in_camera(), gravity.sd_deg()).expect("a direction");
            assert_eq!(CoarseGravity::code(Some(again)), code);
            if code <= CELLS * CELLS {
                assert!(seen.insert(gravity.in_camera().map(f64::to_bits)), "two codes for one direction");
            }
        }
        for code in [CLASSES * CELLS * CELLS + 1, u32::MAX] {
            assert!(matches!(
                CoarseGravity::from_code(code),
                Err(QueryError::Field { field: "gravity", .. })
            ));
        }
    }

    #[test]
    fn rounding_error_is_as_documented() {
        let (mut worst, mut sum, n) = (0.0_f64, 0.0, 200_000);
        for i in 0..n {
            // Evenly spread over the sphere.
            let z: f64 = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(n);
            let turn = f64::from(i) * 2.399_963_229_728_653;
            let r = (1.0 - z * z).sqrt();
            let down = [r * turn.cos(), r * turn.sin(), z];
            let off = angle(CoarseGravity::new(down, 1.0).expect("a direction").in_camera(), down);
            worst = worst.max(off);
            sum += off * off;
        }
        let rms = (sum / f64::from(n)).sqrt();
        assert!(worst < 1.0 && worst > 0.6, "{worst}");
        let about_each = rms / 2.0_f64.sqrt();
        assert!((about_each - CoarseGravity::ROUNDING_SD_DEG).abs() < 0.01, "{about_each}");
    }

    #[test]
    fn any_length_and_deviation_are_encoded() {
        for scale in [1e-300, 1e-3, 9.81, 1e300] {
            let rounded =
                CoarseGravity::new([0.1 * scale, 0.9 * scale, -0.2 * scale], 1.0).expect("a direction");
            assert!(angle(rounded.in_camera(), [0.1, 0.9, -0.2]) < 1.0);
        }
        for (sd, rounded) in [(0.001, 0.5), (0.5, 0.5), (0.6, 1.0), (2.0, 2.0), (5.0, 8.0), (16.0, 16.0)] {
            assert_eq!(CoarseGravity::new([0.0, 1.0, 0.0], sd).map(CoarseGravity::sd_deg), Ok(rounded));
        }
        for axis in [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [-0.0, 1.0, -0.0]]
        {
            assert!(angle(CoarseGravity::new(axis, 1.0).expect("a direction").in_camera(), axis) < 1.0);
        }
    }

    #[test]
    fn invalid_directions_are_rejected() {
        for (down, sd) in [
            ([0.0; 3], 1.0),
            ([f64::NAN, 1.0, 0.0], 1.0),
            ([f64::INFINITY, 1.0, 0.0], 1.0),
            ([0.0, 1.0, 0.0], 0.0),
            ([0.0, 1.0, 0.0], -1.0),
            ([0.0, 1.0, 0.0], 16.1),
            ([0.0, 1.0, 0.0], f64::NAN),
        ] {
            assert_eq!(CoarseGravity::new(down, sd), Err(QueryError::Gravity), "{down:?} {sd}");
        }
        for text in ["", "1,2", "1,2,3,4,5", "a,b,c", "0,0,0", "0,1,0,-2"] {
            assert_eq!(text.parse::<CoarseGravity>(), Err(QueryError::Gravity), "{text}");
        }
        let phone = "0, 9.81, 0".parse::<CoarseGravity>().expect("a direction");
        assert_eq!(phone.sd_deg(), CoarseGravity::PHONE_SD_DEG);
        assert!(!format!("{phone:?}").contains(char::is_numeric));
    }
}
