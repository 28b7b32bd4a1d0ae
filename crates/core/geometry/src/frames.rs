//! Coordinate frames as types: points know their frame, and rigid transforms know both of theirs.

use std::marker::PhantomData;

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

/// The frame of the map, with the frame and unit of its input poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum World {}

/// The frame of a camera: `x` right, `y` down, `z` forward, origin in the projection centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Camera {}

/// The frame of a device's image poses: the frame of its body, or of one of its images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rig {}

/// A camera whose axes were rotated about its centre, as in the radial solvers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TurnedCamera {}

/// A 3D point in frame `F`, in map units.
#[derive(Debug)]
#[repr(transparent)]
pub struct Point3<F> {
    /// Coordinates along the axes of `F`.
    pub coords: Vector3<f64>,
    frame: PhantomData<F>,
}

// Written out because a derive would require the same traits of the marker types.
impl<F> Clone for Point3<F> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<F> Copy for Point3<F> {}

impl<F> PartialEq for Point3<F> {
    fn eq(&self, other: &Self) -> bool {
        self.coords == other.coords
    }
}

impl<F> Point3<F> {
    /// The point with these coordinates along the axes of `F`.
    pub const fn new(x: f64, y: f64, z: f64) -> Self {
        Self { coords: Vector3::new(x, y, z), frame: PhantomData }
    }

    /// The same, from a vector.
    pub const fn from_vector(coords: Vector3<f64>) -> Self {
        Self { coords, frame: PhantomData }
    }

    /// Euclidean distance to another point of the same frame.
    pub fn distance(&self, other: &Self) -> f64 {
        (self.coords - other.coords).norm()
    }

    /// True when no coordinate is NaN or infinite.
    pub fn is_finite(&self) -> bool {
        self.coords.iter().all(|c| c.is_finite())
    }
}

impl Point3<Camera> {
    /// Distance in front of the camera along its optical axis; negative behind it.
    pub fn depth(&self) -> f64 {
        self.coords.z
    }
}

/// A rigid transform of points of frame `In` to frame `Out`: `x_out = R x_in + t`.
///
/// ```text
/// | R  t |      R: rotation, orthonormal, det +1
/// | 0  1 |      t: the origin of `In` in `Out`
/// ```
#[derive(Debug)]
pub struct Rigid3<Out, In> {
    rotation: Rotation3<f64>,
    translation: Vector3<f64>,
    frames: PhantomData<(Out, In)>,
}

/// The pose of a camera in the map, `x_cam = R x_world + t`.
pub type CameraFromWorld = Rigid3<Camera, World>;

/// The pose of a rig in the map, `x_rig = R x_world + t`.
pub type RigFromWorld = Rigid3<Rig, World>;

/// Pose of an image on its rig, `x_cam = R x_rig + t`.
pub type CameraFromRig = Rigid3<Camera, Rig>;

impl<Out, In> Clone for Rigid3<Out, In> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<Out, In> Copy for Rigid3<Out, In> {}

impl<Out, In> PartialEq for Rigid3<Out, In> {
    fn eq(&self, other: &Self) -> bool {
        self.rotation == other.rotation && self.translation == other.translation
    }
}

impl<Out, In> Rigid3<Out, In> {
    /// From a rotation and a translation.
    pub const fn new(rotation: Rotation3<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation, translation, frames: PhantomData }
    }

    /// From a Hamilton quaternion `[w, x, y, z]` of any length and a translation.
    ///
    /// `None` when a number is not finite or the quaternion has no direction.
    pub fn from_quaternion(wxyz: [f64; 4], translation: [f64; 3]) -> Option<Self> {
        let q = Quaternion::new(wxyz[0], wxyz[1], wxyz[2], wxyz[3]);
        let norm = q.norm();
        let finite = norm.is_finite() && translation.iter().all(|c| c.is_finite());
        if !finite || norm < 1e-12 {
            return None;
        }
        Some(Self::new(UnitQuaternion::from_quaternion(q).to_rotation_matrix(), Vector3::from(translation)))
    }

    /// From a matrix that is a rotation up to rounding; the result is the nearest rotation.
    ///
    /// `None` when it is not finite or not within about 1e-3 of a rotation.
    pub fn from_matrix(rotation: Matrix3<f64>, translation: Vector3<f64>) -> Option<Self> {
        let orthonormal = (rotation * rotation.transpose() - Matrix3::identity()).norm() < 1e-3;
        if !orthonormal || rotation.determinant() <= 0.0 || !translation.iter().all(|c| c.is_finite()) {
            return None;
        }
        let svd = rotation.svd(true, true);
        let nearest = svd.u? * svd.v_t?;
        Some(Self::new(Rotation3::from_matrix_unchecked(nearest), translation))
    }

    /// The identity transform.
    pub fn identity() -> Self {
        Self::new(Rotation3::identity(), Vector3::zeros())
    }

    /// `R`, the rotation from `In` to `Out`.
    pub const fn rotation(&self) -> &Rotation3<f64> {
        &self.rotation
    }

    /// `t`, the origin of `In` in `Out`, map units.
    pub const fn translation(&self) -> &Vector3<f64> {
        &self.translation
    }

    /// The rotation as a Hamilton quaternion `[w, x, y, z]` with `w >= 0`.
    pub fn quaternion(&self) -> [f64; 4] {
        let q = UnitQuaternion::from_rotation_matrix(&self.rotation);
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        [sign * q.w, sign * q.i, sign * q.j, sign * q.k]
    }

    /// Transforms a point from `In` to `Out`.
    pub fn transform(&self, point: &Point3<In>) -> Point3<Out> {
        Point3::from_vector(self.rotation * point.coords + self.translation)
    }

    /// The inverse transform.
    pub fn inverse(&self) -> Rigid3<In, Out> {
        let rotation = self.rotation.inverse();
        Rigid3::new(rotation, -(rotation * self.translation))
    }

    /// `self * other`: first `other`, then `self`.
    pub fn compose<Before>(&self, other: &Rigid3<In, Before>) -> Rigid3<Out, Before> {
        Rigid3::new(self.rotation * other.rotation, self.rotation * other.translation + self.translation)
    }

    /// Angle of the rotation between two transforms, in degrees, 0 to 180.
    ///
    /// Accurate for tiny angles too (the arc cosine of the trace loses half of the digits there).
    pub fn rotation_error_degrees(&self, other: &Self) -> f64 {
        let between = self.rotation.inverse() * other.rotation;
        UnitQuaternion::from_rotation_matrix(&between).angle().to_degrees()
    }

    /// True when no number in it is NaN or infinite.
    pub fn is_finite(&self) -> bool {
        self.rotation.matrix().iter().chain(self.translation.iter()).all(|c| c.is_finite())
    }
}

impl<Out> Rigid3<Out, World> {
    /// The origin of `Out` in the map, `-Rᵀ t`, map units: for a camera, its projection centre.
    pub fn center(&self) -> Point3<World> {
        Point3::from_vector(-(self.rotation.inverse() * self.translation))
    }

    /// Distance between the two origins (for cameras, the projection centres), `‖Rᵀt − R̂ᵀt̂‖`, in map units: the
    /// paper's translation error.
    pub fn translation_error(&self, other: &Self) -> f64 {
        self.center().distance(&other.center())
    }

    /// The pose with the tangent step `[ω, v]` applied on the left: `R' = exp(ω) R`, `t' = exp(ω) t + v`.
    ///
    /// `ω` is in radians about the axes of `Out` (for example the camera's), `v` in map units along them. Refinement
    /// and covariance use this chart, so the first three rows of a pose covariance are rotation, the last three
    /// translation.
    pub fn perturbed(&self, step: &[f64; 6]) -> Self {
        let turn = Rotation3::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
        Self::new(turn * self.rotation, turn * self.translation + Vector3::new(step[3], step[4], step[5]))
    }

    /// The step of [`Self::perturbed`] from this pose to another: `self.perturbed(&self.step_to(other))` is `other`.
    pub fn step_to(&self, other: &Self) -> [f64; 6] {
        let turn = other.rotation * self.rotation.inverse();
        let shift = other.translation - turn * self.translation;
        // As a quaternion: the arc cosine of a matrix's trace loses half of the digits of small rotations.
        let turn = UnitQuaternion::from_rotation_matrix(&turn).scaled_axis();
        [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
    }

    /// Covariance of the camera centre in the world frame, map units squared, from the covariance of the pose in the
    /// chart of [`Self::perturbed`].
    ///
    /// The centre moves by `−Rᵀ v` to first order. When the translation block is not finite, infinite on the diagonal
    /// and 0 elsewhere: rotating infinities would give NaN.
    pub fn center_covariance(&self, covariance: &[[f64; 6]; 6]) -> [[f64; 3]; 3] {
        let shift = Matrix3::from_fn(|i, j| covariance[3 + i][3 + j]);
        if !shift.iter().all(|c| c.is_finite()) {
            return std::array::from_fn(|i| {
                std::array::from_fn(|j| if i == j { f64::INFINITY } else { 0.0 })
            });
        }
        let r = self.rotation.matrix();
        let center = r.transpose() * shift * r;
        std::array::from_fn(|i| std::array::from_fn(|j| center[(i, j)]))
    }
}

/// The smallest rotation that turns a direction into `z`; for the opposite of `z`, half a turn about `x`.
pub fn rotation_to_z(direction: &Vector3<f64>) -> Rotation3<f64> {
    UnitQuaternion::rotation_between(direction, &Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
        .to_rotation_matrix()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(seed: f64) -> CameraFromWorld {
        let axis = Vector3::new(seed.sin(), (2.0 * seed).cos(), (3.0 * seed).sin());
        Rigid3::new(Rotation3::from_scaled_axis(axis), Vector3::new(seed, -2.0 * seed, 0.3))
    }

    #[test]
    fn group_laws_hold() {
        for i in 0..200 {
            let a = pose(f64::from(i) * 0.137);
            let b = pose(f64::from(i) * 0.731 + 1.0).inverse();
            let x = Point3::<Camera>::new(0.3, -1.0, 2.0 + f64::from(i));
            let there_and_back = a.inverse().transform(&a.transform(&b.transform(&x)));
            assert!(there_and_back.distance(&b.transform(&x)) < 1e-10);
            assert!(a.compose(&b).transform(&x).distance(&a.transform(&b.transform(&x))) < 1e-10);
        }
    }

    #[test]
    fn quaternions_round_trip_and_invalid_ones_are_rejected() {
        for i in 0..100 {
            let a = pose(f64::from(i) * 0.31);
            let t = a.translation();
            let b = CameraFromWorld::from_quaternion(a.quaternion(), [t.x, t.y, t.z]).expect("finite");
            assert!(a.rotation_error_degrees(&b) < 1e-9);
        }
        assert!(CameraFromWorld::from_quaternion([0.0; 4], [0.0; 3]).is_none());
        assert!(CameraFromWorld::from_quaternion([1.0, f64::NAN, 0.0, 0.0], [0.0; 3]).is_none());
        assert!(CameraFromWorld::from_quaternion([1.0, 0.0, 0.0, 0.0], [f64::INFINITY, 0.0, 0.0]).is_none());
        assert!(CameraFromWorld::from_matrix(-Matrix3::identity(), Vector3::zeros()).is_none());
        assert!(CameraFromWorld::from_matrix(Matrix3::repeat(f64::NAN), Vector3::zeros()).is_none());
    }

    #[test]
    fn step_to_gives_the_other_pose() {
        for i in 0..100 {
            let (a, b) = (pose(f64::from(i) * 0.31), pose(f64::from(i) * 0.17 + 1.0));
            let there = a.perturbed(&a.step_to(&b));
            assert!(there.rotation_error_degrees(&b) < 1e-9 && there.translation_error(&b) < 1e-9, "{i}");
        }
    }

    #[test]
    fn errors_have_known_values() {
        let a = pose(0.4);
        let b = a.perturbed(&[0.0, 0.02_f64.to_radians(), 0.0, 0.0, 0.0, 0.0]);
        assert!((a.rotation_error_degrees(&b) - 0.02).abs() < 1e-9);
        // Rotating the camera frame about its centre leaves the centre unchanged.
        assert!(a.translation_error(&b) < 1e-12);
        let c = a.perturbed(&[0.0, 0.0, 0.0, 0.5, 0.0, 0.0]);
        assert!((a.translation_error(&c) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn step_to_is_the_inverse_of_perturbed() {
        for i in 0..50 {
            let (a, b) = (pose(f64::from(i) * 0.3), pose(f64::from(i) * 0.7 + 2.0));
            let there = a.perturbed(&a.step_to(&b));
            assert!(there.rotation_error_degrees(&b) < 1e-9 && there.translation_error(&b) < 1e-12);
            assert_eq!(a.step_to(&a).map(|s| s.abs() < 1e-12), [true; 6]);
        }
    }

    #[test]
    fn centre_covariance_agrees_with_finite_differences() {
        let pose = pose(0.7);
        // An arbitrary symmetric positive matrix: A Aᵀ for a full A.
        let a = |i: usize, j: usize| (1.3 * i as f64 + 0.7 * (j * j) as f64).sin() + f64::from(i == j);
        let covariance: [[f64; 6]; 6] =
            std::array::from_fn(|i| std::array::from_fn(|j| (0..6).map(|k| a(i, k) * a(j, k)).sum()));
        let moved = |k: usize| {
            let mut step = [0.0; 6];
            step[k] = 1e-6;
            let ahead = pose.perturbed(&step).center().coords;
            step[k] = -1e-6;
            (ahead - pose.perturbed(&step).center().coords) / 2e-6
        };
        let jacobian: [Vector3<f64>; 6] = std::array::from_fn(moved);
        let found = pose.center_covariance(&covariance);
        for i in 0..3 {
            for j in 0..3 {
                let expected: f64 =
                    (0..36).map(|k| jacobian[k / 6][i] * covariance[k / 6][k % 6] * jacobian[k % 6][j]).sum();
                assert!((found[i][j] - expected).abs() < 1e-6, "[{i}][{j}] {} {expected}", found[i][j]);
            }
        }
        let mut free = covariance;
        free[4][4] = f64::INFINITY;
        let free = pose.center_covariance(&free);
        assert_eq!(free.map(|row| row.map(f64::is_nan)), [[false; 3]; 3]);
        assert!((0..3).all(|i| free[i][i] == f64::INFINITY));
    }
}
