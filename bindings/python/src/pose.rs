//! Poses in Python, with PoseLib's names.

use numpy::{IntoPyArray, PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyType;
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix3, Vector3};
use veiloc_pose::solvers::RadialPose;

use crate::arrays;
use crate::errors::{BindingError, Result};

/// Pose of a camera in the world, `x_cam = R x_world + t`.
///
/// Give a quaternion or a rotation matrix; the default is the identity.
///
/// Args:
///     q: quaternion `[w, x, y, z]`; it is normalized.
///     t: translation, `[3]`, map units; zero by default.
///     R: rotation matrix, `[3, 3]`, instead of `q`.
///
/// Raises:
///     InputError: a number is not finite, `q` is zero, or `R` is not a rotation.
#[pyclass(frozen, module = "veiloc", eq, from_py_object)]
#[derive(Clone, Copy, PartialEq)]
pub(crate) struct CameraPose(pub(crate) CameraFromWorld);

/// Quaternion and translation, for pickling.
type Parts = (Vec<f64>, Vec<f64>);

#[pymethods]
impl CameraPose {
    #[new]
    #[pyo3(signature = (q=None, t=None, *, R=None))]
    #[expect(non_snake_case, reason = "the name that the keyword has in Python")]
    fn new(
        q: Option<&Bound<'_, PyAny>>,
        t: Option<&Bound<'_, PyAny>>,
        R: Option<&Bound<'_, PyAny>>,
    ) -> Result<Self> {
        let t = t.map_or(Ok([0.0; 3]), |t| arrays::vector::<3>("t", t))?;
        let pose = match (q, R) {
            (Some(_), Some(_)) => return Err(BindingError::input("give q or R, not both")),
            (_, Some(matrix)) => {
                let rows = arrays::sample::<3, 3>("R", matrix)?;
                CameraFromWorld::from_matrix(Matrix3::from_fn(|i, j| rows[i][j]), Vector3::from(t))
            }
            (Some(q), None) => CameraFromWorld::from_quaternion(arrays::vector::<4>("q", q)?, t),
            (None, None) => CameraFromWorld::from_quaternion([1.0, 0.0, 0.0, 0.0], t),
        };
        pose.map(Self)
            .ok_or_else(|| BindingError::input("the numbers are not finite, or q or R is not a rotation"))
    }

    /// Quaternion `[w, x, y, z]` of length 1 with `w >= 0`, `[4]`.
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.0.quaternion().to_vec().into_pyarray(py)
    }

    /// Translation, `[3]`, map units.
    #[getter]
    fn t<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        arrays::vector3(py, self.0.translation())
    }

    /// Rotation matrix, `[3, 3]`, world to camera.
    #[getter(R)]
    fn rotation<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::matrix3(py, self.0.rotation().matrix())
    }

    /// `[R | t]`, `[3, 4]`.
    #[getter(Rt)]
    fn rotation_and_translation<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::matrix(py, self.rows().into_iter())
    }

    /// Quaternion `[x, y, z, w]` of length 1 with `w >= 0`, `[4]`: the order of ROS and SciPy.
    #[getter]
    fn xyzw<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let [w, x, y, z] = self.0.quaternion();
        vec![x, y, z, w].into_pyarray(py)
    }

    /// `[R | t]` with the last row `[0, 0, 0, 1]`, `[4, 4]`, map to camera: the pose of the camera in the map is
    /// `pose.inverse().matrix`.
    #[getter]
    fn matrix<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let [a, b, c] = self.rows();
        arrays::matrix(py, [a, b, c, [0.0, 0.0, 0.0, 1.0]].into_iter())
    }

    /// The inverse transform: of a camera's pose, the rotation and position of the camera in the map.
    fn inverse(&self) -> Self {
        let inverse = self.0.inverse();
        Self(CameraFromWorld::new(*inverse.rotation(), *inverse.translation()))
    }

    /// Camera centre, `-Rᵀ t`, `[3]`, map units.
    #[getter]
    fn center<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        arrays::vector3(py, &self.0.center().coords)
    }

    /// Errors against another pose: rotation in degrees, and distance of the centres in map units.
    fn error(&self, other: &Self) -> (f64, f64) {
        (self.0.rotation_error_degrees(&other.0), self.0.translation_error(&other.0))
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> (Bound<'py, PyType>, Parts) {
        (py.get_type::<Self>(), (self.0.quaternion().to_vec(), self.0.translation().as_slice().to_vec()))
    }

    fn __repr__(&self) -> String {
        let ([w, x, y, z], t) = (self.0.quaternion(), self.0.translation());
        // Six decimals, or more for a translation of small units.
        let digits = (5.0 - t.amax().log10().floor()).clamp(6.0, 16.0) as usize;
        format!(
            "CameraPose(q=[{w:.6}, {x:.6}, {y:.6}, {z:.6}], t=[{:.digits$}, {:.digits$}, {:.digits$}])",
            t.x, t.y, t.z
        )
    }
}

impl CameraPose {
    /// `[R | t]`.
    fn rows(&self) -> [[f64; 4]; 3] {
        let (r, t) = (self.0.rotation().matrix(), self.0.translation());
        std::array::from_fn(|i| std::array::from_fn(|j| if j < 3 { r[(i, j)] } else { t[i] }))
    }
}

impl From<CameraFromWorld> for CameraPose {
    fn from(pose: CameraFromWorld) -> Self {
        Self(pose)
    }
}

impl From<RadialPose> for CameraPose {
    /// The depth along the ray that the lines share is unknown; it is set to 0, as in PoseLib.
    fn from(pose: RadialPose) -> Self {
        Self(CameraFromWorld::new(pose.rotation, Vector3::new(pose.offset.x, pose.offset.y, 0.0)))
    }
}
