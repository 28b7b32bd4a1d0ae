//! Arbitrary numbers: no panic, and every returned pose is finite and a rotation.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix3, Vector2, Vector3};
use veiloc_geometry::{CameraFromWorld, PlaneLine, PlanePoint, Point3};
use veiloc_pose::solvers::{
    ArrayVec, GravityAlignment, HalfPlane, p3p, p5lp_radial, p6lp, p6lp_dual_radial, u4lp, up2p,
};

/// Numbers of a sample: mostly plain, some special, huge, tiny, or equal to one another.
struct Wild(ChaCha8Rng);

impl Wild {
    fn number(&mut self) -> f64 {
        const SPECIAL: [f64; 12] = [
            0.0,
            -0.0,
            1.0,
            -1.0,
            1e300,
            -1e300,
            1e-300,
            1e160,
            f64::MIN_POSITIVE,
            f64::NAN,
            f64::INFINITY,
            0.5,
        ];
        if self.0.random_range(0..8) == 0 {
            SPECIAL[self.0.random_range(0..SPECIAL.len())]
        } else {
            self.0.random_range(-1.0..1.0) * 10.0_f64.powi(self.0.random_range(-2..3))
        }
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.number())
    }

    /// A unit vector, or NaN.
    fn bearing(&mut self) -> Vector3<f64> {
        let v = self.vector();
        let v = v / v.amax();
        v / v.norm()
    }

    fn plane(&mut self) -> Vector2<f64> {
        Vector2::from_fn(|_, _| self.number())
    }

    fn points<const N: usize>(&mut self) -> [Point3<World>; N] {
        let mut points: [_; N] = std::array::from_fn(|_| Point3::from_vector(self.vector()));
        if self.0.random_range(0..4) == 0 {
            points[0] = points[N - 1];
        }
        points
    }

    fn lines<const N: usize>(&mut self) -> [PlaneLine; N] {
        std::array::from_fn(|_| {
            loop {
                if let Some(line) = PlaneLine::from_normal(self.vector()) {
                    return line;
                }
            }
        })
    }

    fn gravity(&mut self) -> GravityAlignment {
        loop {
            if let Some(gravity) = GravityAlignment::new(&self.vector(), &self.vector()) {
                return gravity;
            }
        }
    }
}

fn sound(r: &Matrix3<f64>, t: &[f64]) -> bool {
    (r * r.transpose()).is_identity(1e-6) && t.iter().all(|c| c.is_finite())
}

fn check(name: &str, poses: &[CameraFromWorld], appended: usize) -> usize {
    assert_eq!(poses.len(), appended);
    for pose in poses {
        assert!(sound(pose.rotation().matrix(), pose.translation().as_slice()), "{name}: {pose:?}");
    }
    appended
}

#[test]
fn solvers_survive_arbitrary_input() {
    let mut wild = Wild(ChaCha8Rng::seed_from_u64(1));
    let mut returned = [0; 6];
    for _ in 0..100_000 {
        let mut out = ArrayVec::new();
        let appended = p3p(&[wild.bearing(), wild.bearing(), wild.bearing()], &wild.points(), &mut out);
        returned[0] += check("p3p", &out, appended);

        let mut out = ArrayVec::new();
        let appended = p6lp(&wild.lines(), &wild.points(), &mut out);
        returned[1] += check("p6lp", &out, appended);

        let mut out = ArrayVec::new();
        let sixth = HalfPlane::of_half_line(PlanePoint::new(wild.number(), wild.number()), wild.plane());
        let anchor = wild.bearing();
        let inward = [(); 5].map(|()| wild.bearing());
        let directions = [(); 5].map(|()| wild.plane());
        let appended = p6lp_dual_radial(&anchor, &inward, &sixth, &wild.points(), &mut out);
        returned[2] += check("p6lp_dual_radial", &out, appended);

        let mut out = ArrayVec::new();
        let appended = p5lp_radial(&directions, &wild.points(), &mut out);
        assert_eq!(appended, out.len());
        for pose in &out {
            assert!(sound(pose.rotation.matrix(), pose.offset.as_slice()), "p5lp_radial: {pose:?}");
        }
        returned[3] += appended;

        let mut out = ArrayVec::new();
        let appended = u4lp(&wild.lines(), &wild.points(), &wild.gravity(), &mut out);
        returned[4] += check("u4lp", &out, appended);

        let mut out = ArrayVec::new();
        let appended = up2p(&[wild.bearing(), wild.bearing()], &wild.points(), &wild.gravity(), &mut out);
        returned[5] += check("up2p", &out, appended);
    }
    assert!(returned.iter().all(|&n| n > 100), "too few poses for a conclusion: {returned:?}");
}

#[test]
fn full_buffer_is_not_exceeded() {
    let mut wild = Wild(ChaCha8Rng::seed_from_u64(2));
    for _ in 0..1000 {
        let mut out = ArrayVec::new();
        while !out.is_full() {
            out.push(CameraFromWorld::identity());
        }
        assert_eq!(u4lp(&wild.lines(), &wild.points(), &wild.gravity(), &mut out), 0);
    }
}
