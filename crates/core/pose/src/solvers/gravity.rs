//! The remaining unknown rotation when the vertical is known: one angle.
//!
//! With the same direction (down, measured by an accelerometer) known in the camera and in the world, the rotation is
//! `R = C · R_z(θ) · Wᵀ`: the columns of `W` are an orthonormal frame of the world whose third axis is down, those of
//! `C` one of the camera. Every equation linear in `R` is then linear in `(cos θ, sin θ)`.

use nalgebra::{Matrix3, Rotation3, Vector3};

/// A discriminant this close to zero, relative to its terms, is a double root plus rounding.
const TANGENT: f64 = 1e-13;

/// The same vertical in the camera and in the world, computed once for all samples of a query.
///
/// ```
/// use veiloc_geometry::nalgebra::Vector3;
/// use veiloc_pose::solvers::GravityAlignment;
///
/// // A camera held upright in a world whose z axis points up.
/// let upright = GravityAlignment::new(&Vector3::y(), &-Vector3::z()).expect("two directions");
/// assert!(GravityAlignment::new(&Vector3::zeros(), &Vector3::y()).is_none());
/// # let _ = upright;
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GravityAlignment {
    /// `C`: columns are axes seen in the camera frame, the third is down.
    pub(crate) camera: Matrix3<f64>,
    /// `W`: columns are axes seen in the world frame, the third is down.
    pub(crate) world: Matrix3<f64>,
}

impl GravityAlignment {
    /// From one direction seen in both frames, of any length: down in either, or any other direction that is known.
    ///
    /// `None` when a vector has no direction or is not finite.
    pub fn new(down_in_camera: &Vector3<f64>, down_in_world: &Vector3<f64>) -> Option<Self> {
        Some(Self { camera: axes_about(down_in_camera)?, world: axes_about(down_in_world)? })
    }

    /// `R` of `cam_from_world` for one angle given by its cosine and sine.
    #[inline]
    pub(crate) fn rotation(&self, cos: f64, sin: f64) -> Rotation3<f64> {
        let c = &self.camera;
        let turned = Matrix3::from_columns(&[
            c.column(0) * cos + c.column(1) * sin,
            c.column(1) * cos - c.column(0) * sin,
            c.column(2).into(),
        ]);
        Rotation3::from_matrix_unchecked(turned * self.world.transpose())
    }
}

/// Right-handed orthonormal axes with this direction as the third.
fn axes_about(direction: &Vector3<f64>) -> Option<Matrix3<f64>> {
    let norm = direction.norm();
    if !(norm > 1e-12 && norm.is_finite()) {
        return None;
    }
    let z = direction / norm;
    let mut least = Vector3::zeros();
    least[z.iamin()] = 1.0;
    let x = least.cross(&z);
    // A unit vector's smallest component is at most 0.58: the product is never short.
    let x = x / x.norm();
    Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
}

/// Intersections of the line `a c + b s + d = 0` with the circle `c² + s² = 1`: cosine and sine of two angles, NaN for
/// none.
///
/// Homogeneous in the angle, so none is special. The line must be known to exist (`a`, `b` not both rounding).
#[inline]
pub(crate) fn angles_on_line(a: f64, b: f64, d: f64) -> [[f64; 2]; 2] {
    let size = a * a + b * b;
    let inside = size - d * d;
    // A double root may come out slightly below zero by rounding; the root of any other negative number is NaN.
    let half_chord = if inside.abs() < TANGENT * size { 0.0 } else { inside.sqrt() };
    let inverse = 1.0 / size;
    // a² + b² times the unit vectors, to the last digit but one.
    let (x, y) = (-d * inverse, half_chord * inverse);
    let second = if half_chord == 0.0 { f64::NAN } else { -y };
    [y, second].map(|y| [a * x - b * y, b * x + a * y])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rotation_takes_down_to_down_for_every_angle() {
        let downs = [
            Vector3::x(),
            -Vector3::y(),
            Vector3::z(),
            Vector3::new(0.3, -2.0, 0.7),
            Vector3::new(1e-9, 1.0, 0.0),
        ];
        for camera in &downs {
            for world in &downs {
                let alignment = GravityAlignment::new(camera, world).expect("two directions");
                for k in 0..16 {
                    let (sin, cos) = (f64::from(k) * 0.41).sin_cos();
                    let r = alignment.rotation(cos, sin);
                    assert!((r.matrix() * r.matrix().transpose()).is_identity(1e-12));
                    assert!((r.matrix().determinant() - 1.0).abs() < 1e-12);
                    assert!((r * world.normalize() - camera.normalize()).norm() < 1e-12);
                }
            }
        }
        assert!(GravityAlignment::new(&Vector3::z(), &Vector3::new(f64::NAN, 0.0, 1.0)).is_none());
        assert!(GravityAlignment::new(&Vector3::new(f64::INFINITY, 0.0, 0.0), &Vector3::z()).is_none());
    }

    #[test]
    fn a_line_meets_the_circle_at_any_angle() {
        for k in 0..3600 {
            // Dense around 0, a quarter turn and a half turn too: k counts tenths of degrees.
            let (sin, cos) = (f64::from(k) * 0.1_f64).to_radians().sin_cos();
            for tilt in [0.0_f64, 0.3, 1.2, 2.9] {
                let (a, b) = (tilt.cos() * 3.0, tilt.sin() * 3.0);
                let found = angles_on_line(a, b, -(a * cos + b * sin));
                let near = |p: &[f64; 2]| (p[0] - cos).abs() + (p[1] - sin).abs() < 1e-6;
                assert!(found.iter().any(near), "{k} {tilt}: {found:?}");
                assert!(
                    found.iter().all(|[c, s]| !((c * c + s * s - 1.0).abs() > 1e-12)),
                    "{k} {tilt}: {found:?}"
                );
            }
        }
        for [a, b, d] in [[1.0, 0.0, 1.1], [f64::NAN, 0.0, 0.1], [0.0, 0.0, 0.0]] {
            assert!(angles_on_line(a, b, d).as_flattened().iter().all(|x| x.is_nan()), "{a} {b} {d}");
        }
    }
}
