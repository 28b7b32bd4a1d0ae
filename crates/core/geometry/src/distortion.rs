//! Lens distortion on the plane `z = 1`, and its inverse.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix2, Vector2};

/// From a position on the plane to the observed position, in units of the focal length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Distortion {
    None,
    /// Polynomials of the position.
    Plane(Planar),
    /// First `r` becomes the angle to the axis, `atan r`, then the polynomials.
    Fisheye(Planar),
    /// `atan(2 r tan(ω/2)) / ω` for this `ω`.
    Fov(f64),
}

/// Brown and Conrady's distortion with a divisor and thin prisms: COLMAP's terms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Planar {
    /// Coefficients of `r²`, `r⁴`, `r⁶`, `r⁸`.
    pub(crate) radial: [f64; 4],
    /// Coefficients of `r²`, `r⁴`, `r⁶`, in the divisor.
    pub(crate) divisor: [f64; 3],
    /// `p1, p2`
    pub(crate) tangential: [f64; 2],
    /// `sx1, sy1`
    pub(crate) prism: [f64; 2],
}

/// Below this `ω²` or `r²` the first terms of the series are more accurate than the quotient.
const SMALL: f64 = 1e-8;

impl Distortion {
    /// The observed position of a position on the plane.
    pub(crate) fn distort(&self, p: Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::None => p,
            Self::Plane(planar) => planar.distort(p),
            Self::Fisheye(planar) => planar.distort(p * atan_over(p.norm())),
            Self::Fov(omega) => p * fov(*omega, p.norm()),
        }
    }

    /// The position on the plane for an observed position; `None` beyond a fold, at 90° from the axis or more, and for
    /// values that are not finite.
    pub(crate) fn undistort(&self, target: Vector2<f64>) -> Option<Vector2<f64>> {
        if !(target.x.is_finite() && target.y.is_finite()) {
            return None;
        }
        match self {
            Self::None => Some(target),
            Self::Plane(planar) => planar.undistort(target),
            Self::Fisheye(planar) => {
                let angle = planar.undistort(target)?;
                let theta = angle.norm();
                (theta < FRAC_PI_2 - 1e-6).then(|| angle * tan_over(theta))
            }
            Self::Fov(omega) => {
                let seen = target.norm();
                if seen * omega.abs() >= FRAC_PI_2 - 1e-6 {
                    return None;
                }
                Some(target * fov_inverse(*omega, seen))
            }
        }
    }
}

/// `atan(r) / r`
fn atan_over(r: f64) -> f64 {
    if r * r < SMALL { 1.0 - r * r / 3.0 } else { r.atan() / r }
}

/// `tan(θ) / θ`
fn tan_over(theta: f64) -> f64 {
    if theta * theta < SMALL { 1.0 + theta * theta / 3.0 } else { theta.tan() / theta }
}

/// `atan(2 r tan(ω/2)) / (ω r)`
fn fov(omega: f64, r: f64) -> f64 {
    // For a field of view near zero this is nearly the pinhole model.
    if omega * omega < SMALL {
        return 1.0 + omega * omega * (1.0 / 12.0 - r * r / 3.0);
    }
    let slope = 2.0 * (omega / 2.0).tan();
    slope * atan_over(slope * r) / omega
}

/// `tan(ω s) / (2 s tan(ω/2))`
fn fov_inverse(omega: f64, seen: f64) -> f64 {
    if omega * omega < SMALL {
        return 1.0 + omega * omega * (seen * seen / 3.0 - 1.0 / 12.0);
    }
    omega * tan_over(omega * seen) / (2.0 * (omega / 2.0).tan())
}

impl Planar {
    /// No distortion.
    pub(crate) const NONE: Self =
        Self { radial: [0.0; 4], divisor: [0.0; 3], tangential: [0.0; 2], prism: [0.0; 2] };

    /// The radial factor and its derivative by `r²`.
    fn radial(&self, r2: f64) -> (f64, f64) {
        let [k1, k2, k3, k4] = self.radial;
        let [d1, d2, d3] = self.divisor;
        let over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
        let under = 1.0 + r2 * (d1 + r2 * (d2 + r2 * d3));
        let over_slope = k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3 + r2 * 4.0 * k4));
        let under_slope = d1 + r2 * (2.0 * d2 + r2 * 3.0 * d3);
        (over / under, (over_slope * under - over * under_slope) / (under * under))
    }

    fn distort(&self, p: Vector2<f64>) -> Vector2<f64> {
        let (xx, yy, xy) = (p.x * p.x, p.y * p.y, p.x * p.y);
        let r2 = xx + yy;
        let ([p1, p2], [sx, sy], (radial, _)) = (self.tangential, self.prism, self.radial(r2));
        Vector2::new(
            p.x * radial + 2.0 * p1 * xy + p2 * (r2 + 2.0 * xx) + sx * r2,
            p.y * radial + 2.0 * p2 * xy + p1 * (r2 + 2.0 * yy) + sy * r2,
        )
    }

    fn jacobian(&self, p: Vector2<f64>) -> Matrix2<f64> {
        let (x, y) = (p.x, p.y);
        let ([p1, p2], [sx, sy]) = (self.tangential, self.prism);
        let (radial, by_r2) = self.radial(x * x + y * y);
        let slope = 2.0 * by_r2;
        let off = slope * x * y + 2.0 * (p1 * x + p2 * y);
        Matrix2::new(
            radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x + 2.0 * sx * x,
            off + 2.0 * sx * y,
            off + 2.0 * sy * x,
            radial + slope * y * y + 2.0 * p2 * x + 6.0 * p1 * y + 2.0 * sy * y,
        )
    }

    /// Newton's method from the distorted position; the result is strictly checked.
    fn undistort(&self, target: Vector2<f64>) -> Option<Vector2<f64>> {
        if *self == Self::NONE {
            return Some(target);
        }
        let mut p = target;
        for _ in 0..50 {
            let residual = self.distort(p) - target;
            let step = self.jacobian(p).try_inverse()? * residual;
            p -= step;
            if step.norm() < 1e-14 * (1.0 + p.norm()) {
                break;
            }
        }
        // Beyond the fold a polynomial distortion has other roots; the true one preserves the orientation of the plane.
        let solved = (self.distort(p) - target).norm() < 1e-10 * (1.0 + target.norm());
        let unfolded = self.jacobian(p).determinant() > 0.0 && p.dot(&target) >= 0.0;
        (solved && unfolded).then_some(p)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Planar; 3] = [
        Planar { radial: [-0.15, 0.05, 0.0, 0.0], tangential: [0.001, -0.0007], ..Planar::NONE },
        Planar {
            radial: [0.2, -0.1, 0.03, 0.0],
            divisor: [0.1, 0.02, -0.01],
            tangential: [0.002, 0.001],
            ..Planar::NONE
        },
        Planar {
            radial: [-0.02, 0.01, -0.003, 0.0005],
            tangential: [0.001, -0.002],
            prism: [0.003, -0.001],
            ..Planar::NONE
        },
    ];

    #[test]
    fn jacobian_agrees_with_finite_differences() {
        let p = Vector2::new(0.31, -0.47);
        let h = 1e-6;
        for planar in ALL {
            let j = planar.jacobian(p);
            for c in 0..2 {
                let mut step = Vector2::zeros();
                step[c] = h;
                let numeric = (planar.distort(p + step) - planar.distort(p - step)) / (2.0 * h);
                assert!((numeric - j.column(c)).norm() < 1e-9, "{planar:?}");
            }
        }
    }

    #[test]
    fn distortion_is_invertible() {
        let lenses = ALL.into_iter().flat_map(|p| [Distortion::Plane(p), Distortion::Fisheye(p)]);
        let fovs = [0.0, 1e-5, 1e-3, 0.9, -0.9, 1.8].map(Distortion::Fov);
        for lens in lenses.chain(fovs).chain([Distortion::None]) {
            for r in [0.0, 1e-9, 1e-5, 1e-4, 1e-3, 0.1, 0.5, 0.8] {
                let p = Vector2::new(0.6 * r, -0.8 * r);
                let back = lens.undistort(lens.distort(p)).expect("within the lens");
                assert!((back - p).norm() < 1e-12, "{lens:?} {r}: {}", (back - p).norm());
            }
        }
    }

    #[test]
    fn ninety_degrees_and_more_have_no_position() {
        let fisheye = Distortion::Fisheye(Planar::NONE);
        assert!(fisheye.undistort(Vector2::new(1.5, 0.0)).is_some());
        assert!(fisheye.undistort(Vector2::new(1.6, 0.0)).is_none());
        assert!(Distortion::Fov(1.0).undistort(Vector2::new(0.0, 1.6)).is_none());
    }
}
