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
    /// First the angle to the axis with radial terms, then the other terms of what that gives: the order of Aria's model.
    FisheyeInTwoSteps(Planar, Planar),
    /// `atan(2 r tan(ω/2)) / ω` for this `ω`.
    Fov(f64),
    /// The observed position at distance `s` from the centre, divided by `1 + k s²`, is the position on the plane.
    Division(f64),
    /// `r / (α √(β r² + 1) + 1 − α)` for these `α` and `β`.
    Eucm(f64, f64),
}

/// Brown and Conrady's distortion with a divisor and thin prisms: COLMAP's terms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Planar {
    /// Coefficients of `r²`, `r⁴`, and so on to `r¹²`.
    pub(crate) radial: [f64; 6],
    /// Coefficients of `r²`, `r⁴`, `r⁶`, in the divisor.
    pub(crate) divisor: [f64; 3],
    /// `p1, p2`
    pub(crate) tangential: [f64; 2],
    /// Coefficients of `r²` and `r⁴` along `x`, then along `y`.
    pub(crate) prism: [[f64; 2]; 2],
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
            Self::FisheyeInTwoSteps(radial, rest) => rest.distort(radial.distort(p * atan_over(p.norm()))),
            Self::Fov(omega) => p * fov(*omega, p.norm()),
            // Beyond the fold the root is 0, where the position is that of the fold or farther.
            Self::Division(k) => p * (2.0 / (1.0 + (1.0 - 4.0 * k * p.norm_squared()).max(0.0).sqrt())),
            Self::Eucm(alpha, beta) => p / (alpha * (beta * p.norm_squared() + 1.0).sqrt() + 1.0 - alpha),
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
            Self::Fisheye(planar) => from_angle(planar.undistort(target)?),
            Self::FisheyeInTwoSteps(radial, rest) => from_angle(radial.undistort(rest.undistort(target)?)?),
            Self::Fov(omega) => {
                let seen = target.norm();
                if seen * omega.abs() >= FRAC_PI_2 - 1e-6 {
                    return None;
                }
                Some(target * fov_inverse(*omega, seen))
            }
            Self::Division(k) => {
                let bend = k * target.norm_squared();
                // From 90° on the divisor is 0 or less; from 1 on a positive k folds the image.
                (bend > -1.0 + 1e-6 && bend < 1.0).then(|| target / (1.0 + bend))
            }
            Self::Eucm(alpha, beta) => {
                let r2 = target.norm_squared();
                let under = 1.0 - (2.0 * alpha - 1.0) * beta * r2;
                let depth = (1.0 - beta * alpha * alpha * r2) / (alpha * under.sqrt() + 1.0 - alpha);
                (under >= 0.0 && depth > 1e-6 && depth.is_finite()).then(|| target / depth)
            }
        }
    }
}

/// The position on the plane for an angle to the axis and its direction; `None` from 90° on.
fn from_angle(angle: Vector2<f64>) -> Option<Vector2<f64>> {
    let theta = angle.norm();
    (theta < FRAC_PI_2 - 1e-6).then(|| angle * tan_over(theta))
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
        Self { radial: [0.0; 6], divisor: [0.0; 3], tangential: [0.0; 2], prism: [[0.0; 2]; 2] };

    /// Radial terms only: coefficients of `r²`, `r⁴`, and so on.
    pub(crate) const fn of_radial<const N: usize>(given: [f64; N]) -> Self {
        let mut radial = [0.0; 6];
        let mut i = 0;
        while i < N {
            radial[i] = given[i];
            i += 1;
        }
        Self { radial, ..Self::NONE }
    }

    /// The radial factor and its derivative by `r²`.
    fn radial(&self, r2: f64) -> (f64, f64) {
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        let [d1, d2, d3] = self.divisor;
        let over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * (k4 + r2 * (k5 + r2 * k6)))));
        let under = 1.0 + r2 * (d1 + r2 * (d2 + r2 * d3));
        let over_slope =
            k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3 + r2 * (4.0 * k4 + r2 * (5.0 * k5 + r2 * 6.0 * k6))));
        let under_slope = d1 + r2 * (2.0 * d2 + r2 * 3.0 * d3);
        (over / under, (over_slope * under - over * under_slope) / (under * under))
    }

    fn distort(&self, p: Vector2<f64>) -> Vector2<f64> {
        let (xx, yy, xy) = (p.x * p.x, p.y * p.y, p.x * p.y);
        let r2 = xx + yy;
        let ([p1, p2], [sx, sy], (radial, _)) = (self.tangential, self.prism, self.radial(r2));
        let prism = |s: [f64; 2]| r2 * (s[0] + r2 * s[1]);
        Vector2::new(
            p.x * radial + 2.0 * p1 * xy + p2 * (r2 + 2.0 * xx) + prism(sx),
            p.y * radial + 2.0 * p2 * xy + p1 * (r2 + 2.0 * yy) + prism(sy),
        )
    }

    fn jacobian(&self, p: Vector2<f64>) -> Matrix2<f64> {
        let (x, y) = (p.x, p.y);
        let ([p1, p2], [sx, sy]) = (self.tangential, self.prism);
        let r2 = x * x + y * y;
        let (radial, by_r2) = self.radial(r2);
        let slope = 2.0 * by_r2;
        let off = slope * x * y + 2.0 * (p1 * x + p2 * y);
        let prism = |s: [f64; 2]| 2.0 * (s[0] + 2.0 * r2 * s[1]);
        Matrix2::new(
            radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x + prism(sx) * x,
            off + prism(sx) * y,
            off + prism(sy) * x,
            radial + slope * y * y + 2.0 * p2 * x + 6.0 * p1 * y + prism(sy) * y,
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
        Planar { tangential: [0.001, -0.0007], ..Planar::of_radial([-0.15, 0.05]) },
        Planar {
            divisor: [0.1, 0.02, -0.01],
            tangential: [0.002, 0.001],
            ..Planar::of_radial([0.2, -0.1, 0.03])
        },
        Planar {
            tangential: [0.001, -0.002],
            prism: [[0.003, 0.002], [-0.001, 0.004]],
            ..Planar::of_radial([-0.02, 0.01, -0.003, 0.0005, 0.002, -0.001])
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
        let others = [
            Distortion::None,
            Distortion::FisheyeInTwoSteps(
                Planar::of_radial([-0.03, 0.01, 0.002, -0.004, 0.001, -0.0002]),
                ALL[2],
            ),
            Distortion::Division(-0.3),
            Distortion::Division(0.2),
            Distortion::Eucm(0.6, 1.1),
            Distortion::Eucm(0.0, 1.0),
            Distortion::Eucm(1.0, 0.5),
        ];
        for lens in lenses.chain(fovs).chain(others) {
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
        // At 90° the division model is at 1 / √−k, and the unified one at 1 / (α √β).
        let division = Distortion::Division(-0.25);
        assert!(division.undistort(Vector2::new(1.9, 0.0)).is_some());
        assert!(division.undistort(Vector2::new(0.0, 2.1)).is_none());
        let folded = Distortion::Division(0.25);
        assert!(folded.undistort(Vector2::new(1.9, 0.0)).is_some());
        assert!(folded.undistort(folded.distort(Vector2::new(1.5, 0.0))).is_none(), "beyond the fold");
        let unified = Distortion::Eucm(0.5, 4.0);
        assert!(unified.undistort(Vector2::new(0.9, 0.0)).is_some());
        assert!(unified.undistort(Vector2::new(0.0, 1.1)).is_none());
    }
}
