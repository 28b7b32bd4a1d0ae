//! Rotation of a session's layout relative to the camera of a frame.

use std::fmt;

use veiloc_geometry::nalgebra::{Rotation3, UnitQuaternion, Vector3};

use crate::QueryError;

/// Steps of a code per radian.
const PER_RADIAN: f64 = 1e6;
/// The largest code: half a turn.
const LARGEST: i32 = 3_141_593;

/// The rotation from the layout's frame to the camera's frame, as a rotation vector in millionths of a radian, so that
/// device and server compute with exactly the same rotation. Zero where the layout is fixed in the image.
///
/// Between the frames of a session it reveals how the camera turned, which the server also estimates from the poses.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct LayoutTurn([i32; 3]);

impl LayoutTurn {
    /// Rounds a rotation `cam_from_layout`; `None` when it is not finite.
    pub fn new(cam_from_layout: &Rotation3<f64>) -> Option<Self> {
        // Via a quaternion: the angle of a matrix is the arc cosine of its trace, which rounding can take beyond 1 for
        // the identity.
        let vector = UnitQuaternion::from_rotation_matrix(cam_from_layout).scaled_axis();
        let is_finite = cam_from_layout.matrix().iter().chain(&vector).all(|x| x.is_finite());
        is_finite.then(|| {
            let code = |x: f64| ((x * PER_RADIAN).round() as i32).clamp(-LARGEST, LARGEST);
            Self([code(vector.x), code(vector.y), code(vector.z)])
        })
    }

    /// Whether the layout is fixed in the image.
    pub fn is_none(self) -> bool {
        self.0 == [0; 3]
    }

    /// The rotation.
    pub fn cam_from_layout(self) -> Rotation3<f64> {
        let [x, y, z] = self.0.map(|code| f64::from(code) / PER_RADIAN);
        Rotation3::from_scaled_axis(Vector3::new(x, y, z))
    }

    /// As on the wire: three 32-bit numbers, two's complement.
    pub(crate) fn codes(self) -> [u32; 3] {
        self.0.map(i32::cast_unsigned)
    }

    pub(crate) fn from_codes(codes: [u32; 3]) -> Result<Self, QueryError> {
        let codes = codes.map(u32::cast_signed);
        match codes.iter().find(|code| code.unsigned_abs() > LARGEST.unsigned_abs()) {
            None => Ok(Self(codes)),
            Some(code) => Err(QueryError::Field {
                field: "turn",
                value: code.cast_unsigned(),
                allowed: "from -3141593 to 3141593",
            }),
        }
    }
}

// The motion of a device must not appear in logs.
impl fmt::Debug for LayoutTurn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("LayoutTurn")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_round_trip_after_rounding() {
        for [x, y, z] in [[0.0; 3], [0.1, -0.2, 0.3], [3.0, 0.4, -0.2], [0.0, 3.0, 0.0]] {
            let turn = Rotation3::from_scaled_axis(Vector3::new(x, y, z));
            let rounded = LayoutTurn::new(&turn).expect("finite");
            assert!(rounded.cam_from_layout().angle_to(&turn) < 2e-6);
            assert_eq!(LayoutTurn::from_codes(rounded.codes()).expect("own codes"), rounded);
            assert_eq!(rounded.is_none(), [x, y, z] == [0.0; 3]);
        }
        // The identity with its diagonal rounded upwards.
        let nothing = veiloc_geometry::nalgebra::Matrix3::from_diagonal_element(1.0 + 1e-15);
        let rounded = LayoutTurn::new(&Rotation3::from_matrix_unchecked(nothing)).expect("finite");
        assert!(rounded.is_none());
        assert!(LayoutTurn::from_codes([0, 3_141_594, 0]).is_err());
        assert!(LayoutTurn::from_codes([i32::MIN.cast_unsigned(), 0, 0]).is_err());
        let bad = Rotation3::from_matrix_unchecked(veiloc_geometry::nalgebra::Matrix3::repeat(f64::NAN));
        assert!(LayoutTurn::new(&bad).is_none());
    }
}
