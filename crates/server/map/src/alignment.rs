//! How well the coordinate frame of a map is known, if it was aligned to known positions.

/// Standard deviations of the alignment of a map: of its coordinate frame on earth, not of places within the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlignmentAccuracy {
    /// Of the logarithm of the scale.
    pub scale: f64,
    /// Of the up direction, degrees (the root mean square angle).
    pub tilt_deg: f64,
    /// Of the rotation about up, degrees.
    pub heading_deg: f64,
    /// Of the position of [`Self::center`], map units (the root mean square distance).
    pub position: f64,
    /// Where the position is known best, map units.
    pub center: [f64; 3],
}

impl AlignmentAccuracy {
    /// The accuracy after a transform to a frame that is known to `other`.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let (position, _) = other.at(self.center);
        Self {
            scale: self.scale.hypot(other.scale),
            tilt_deg: self.tilt_deg.hypot(other.tilt_deg),
            heading_deg: self.heading_deg.hypot(other.heading_deg),
            position: self.position.hypot(position * 3.0_f64.sqrt()),
            center: self.center,
        }
    }

    /// As the map file stores it.
    pub(crate) const fn numbers(&self) -> [f64; 7] {
        let [x, y, z] = self.center;
        [self.scale, self.tilt_deg, self.heading_deg, self.position, x, y, z]
    }

    /// Of stored numbers.
    pub(crate) fn from_stored(numbers: [f64; 7]) -> Result<Self, String> {
        let [scale, tilt_deg, heading_deg, position, x, y, z] = numbers;
        let is_valid = numbers.iter().all(|n| n.is_finite()) && numbers[..4].iter().all(|sd| *sd >= 0.0);
        let found = Self { scale, tilt_deg, heading_deg, position, center: [x, y, z] };
        if is_valid { Ok(found) } else { Err("not standard deviations and a position".to_owned()) }
    }

    /// Standard deviation of the position on earth of a place in the map, map units, and of an orientation there, degrees: each
    /// the root mean square over three axes.
    pub fn at(&self, place: [f64; 3]) -> (f64, f64) {
        let [x, y, z] = [0, 1, 2].map(|k| place[k] - self.center[k]);
        let (ground, height) = (x.hypot(y), z);
        let (tilt, heading) = (self.tilt_deg.to_radians(), self.heading_deg.to_radians());
        // A tilt moves places beside the centre up or down, and places above it sideways.
        let moved = [
            self.scale * ground.hypot(height),
            heading * ground,
            tilt * ground * std::f64::consts::FRAC_1_SQRT_2,
            tilt * height,
        ];
        let position = moved.iter().fold(self.position, |all, one| all.hypot(*one));
        let per_axis = 3.0_f64.sqrt().recip();
        (position * per_axis, self.tilt_deg.hypot(self.heading_deg) * per_axis)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_far_from_the_centre_are_known_worse() {
        let accuracy = AlignmentAccuracy {
            scale: 0.01,
            tilt_deg: 2.0,
            heading_deg: 1.0,
            position: 0.3,
            center: [5.0, 0.0, 1.0],
        };
        let (position, orientation) = accuracy.at([5.0, 0.0, 1.0]);
        assert!((position - 0.3 / 3.0_f64.sqrt()).abs() < 1e-12);
        assert!((orientation - (5.0_f64 / 3.0).sqrt()).abs() < 1e-12);
        // 100 m away: 1 m by the scale, 1.75 m by the heading, 2.47 m by the tilt.
        let (far, _) = accuracy.at([105.0, 0.0, 1.0]);
        let expected = (0.09 + 1.0 + 1.7453_f64.powi(2) + 2.4683_f64.powi(2)) / 3.0;
        assert!((far - expected.sqrt()).abs() < 1e-3, "{far}");
        assert!(AlignmentAccuracy::from_stored([0.1, f64::NAN, 1.0, 1.0, 0.0, 0.0, 0.0]).is_err());
        assert!(AlignmentAccuracy::from_stored([0.1, 1.0, 1.0, -1.0, 0.0, 0.0, 0.0]).is_err());
        assert_eq!(AlignmentAccuracy::from_stored(accuracy.numbers()), Ok(accuracy));
    }
}
