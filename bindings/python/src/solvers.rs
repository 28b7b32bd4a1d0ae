//! The minimal solvers, named as in PoseLib. Each takes a minimal sample and returns all poses that explain it.
//!
//! A degenerate sample, or one that is not finite, gives no poses and no error.

use pyo3::prelude::*;
use veiloc_geometry::nalgebra::{Vector2, Vector3};
use veiloc_geometry::{CameraFromWorld, PlaneLine, Point3, frames::World};
use veiloc_pose::solvers::{ArrayVec, GravityAlignment, HalfPlane};

use crate::arrays;
use crate::errors::{BindingError, Result};
use crate::pose::CameraPose;

/// Default down direction: the second axis of the camera and of the world, as in PoseLib's upright solvers.
const DOWN: [f64; 3] = [0.0, 1.0, 0.0];

fn points<const N: usize>(array: &Bound<'_, PyAny>) -> Result<[Point3<World>; N]> {
    Ok(arrays::sample::<N, 3>("points3d", array)?.map(|[x, y, z]| Point3::new(x, y, z)))
}

fn vectors<const N: usize>(what: &str, array: &Bound<'_, PyAny>) -> Result<[Vector3<f64>; N]> {
    Ok(arrays::sample::<N, 3>(what, array)?.map(Vector3::from))
}

/// Lines of the plane `z = 1`, of any scale; `None` when one of them is degenerate.
fn lines<const N: usize>(array: &Bound<'_, PyAny>) -> Result<Option<[PlaneLine; N]>> {
    let lines: Option<Vec<PlaneLine>> =
        vectors::<N>("lines", array)?.into_iter().map(PlaneLine::from_normal).collect();
    Ok(lines.and_then(|lines| lines.try_into().ok()))
}

fn gravity(
    in_camera: Option<&Bound<'_, PyAny>>,
    in_world: Option<&Bound<'_, PyAny>>,
) -> Result<GravityAlignment> {
    let down = |what: &str, given: Option<&Bound<'_, PyAny>>| -> Result<Vector3<f64>> {
        Ok(Vector3::from(given.map_or(Ok(DOWN), |v| arrays::vector::<3>(what, v))?))
    };
    let alignment =
        GravityAlignment::new(&down("down_in_camera", in_camera)?, &down("down_in_world", in_world)?);
    alignment.ok_or_else(|| {
        BindingError::input("down_in_camera, down_in_world: must be vectors that are not zero")
    })
}

fn found<const N: usize>(poses: ArrayVec<CameraFromWorld, N>) -> Vec<CameraPose> {
    poses.into_iter().map(CameraPose).collect()
}

/// Poses from three points (P3P).
///
/// Args:
///     bearings: `[3, 3]`, directions of the points in the camera frame, of any length.
///     points3d: `[3, 3]`, map units.
///
/// Returns:
///     At most 4 poses.
#[pyfunction]
pub(crate) fn p3p(bearings: &Bound<'_, PyAny>, points3d: &Bound<'_, PyAny>) -> Result<Vec<CameraPose>> {
    let mut poses = ArrayVec::new();
    let unit = vectors::<3>("bearings", bearings)?.map(|b| b.normalize());
    veiloc_pose::solvers::p3p(&unit, &points(points3d)?, &mut poses);
    Ok(found(poses))
}

/// Poses from six lines of the image and the points on them.
///
/// Args:
///     lines: `[6, 3]`, lines of the plane z = 1 (`Kᵀ l` for a line `l` in pixels), of any scale.
///     points3d: `[6, 3]`, map units.
///
/// Returns:
///     At most 8 poses.
#[pyfunction]
pub(crate) fn p6lp(lines: &Bound<'_, PyAny>, points3d: &Bound<'_, PyAny>) -> Result<Vec<CameraPose>> {
    let mut poses = ArrayVec::new();
    let points = points(points3d)?;
    if let Some(lines) = self::lines(lines)? {
        veiloc_pose::solvers::p6lp(&lines, &points, &mut poses);
    }
    Ok(found(poses))
}

/// Poses from five half-lines with a common start in the image, up to the depth along its ray.
///
/// Args:
///     directions: `[5, 2]`, directions of the half-lines in a camera whose z axis is the common ray.
///     points3d: `[5, 3]`, map units.
///
/// Returns:
///     At most 4 poses, with `t[2] = 0`.
#[pyfunction]
pub(crate) fn p5lp_radial(
    directions: &Bound<'_, PyAny>,
    points3d: &Bound<'_, PyAny>,
) -> Result<Vec<CameraPose>> {
    let mut poses = ArrayVec::new();
    let directions = arrays::sample::<5, 2>("directions", directions)?.map(Vector2::from);
    veiloc_pose::solvers::p5lp_radial(&directions, &points(points3d)?, &mut poses);
    Ok(poses.into_iter().map(CameraPose::from).collect())
}

/// Poses from five half-planes of one anchor and one half-plane of another anchor.
///
/// All directions are in the camera frame, of any length.
///
/// Args:
///     anchor: `[3]`, direction of the anchor that five half-planes share.
///     inward: `[5, 3]`, direction of each half-plane at the anchor.
///     sixth_axis, sixth_inward: `[3]`, the same two directions for the sixth half-plane.
///     points3d: `[6, 3]`, map units.
///
/// Returns:
///     At most 4 poses.
#[pyfunction]
pub(crate) fn p6lp_dual_radial(
    anchor: &Bound<'_, PyAny>,
    inward: &Bound<'_, PyAny>,
    sixth_axis: &Bound<'_, PyAny>,
    sixth_inward: &Bound<'_, PyAny>,
    points3d: &Bound<'_, PyAny>,
) -> Result<Vec<CameraPose>> {
    let mut poses = ArrayVec::new();
    let sixth = HalfPlane {
        axis: Vector3::from(arrays::vector::<3>("sixth_axis", sixth_axis)?),
        inward: Vector3::from(arrays::vector::<3>("sixth_inward", sixth_inward)?),
    };
    let anchor = Vector3::from(arrays::vector::<3>("anchor", anchor)?);
    let inward = vectors::<5>("inward", inward)?;
    veiloc_pose::solvers::p6lp_dual_radial(&anchor, &inward, &sixth, &points(points3d)?, &mut poses);
    Ok(found(poses))
}

/// Poses from two points and a known vertical (upright P2P).
///
/// Args:
///     bearings: `[2, 3]`, directions of the points in the camera frame, of any length.
///     points3d: `[2, 3]`, map units.
///     down_in_camera, down_in_world: `[3]`, the vertical in both frames. Default: the second axis of each.
///
/// Returns:
///     At most 2 poses.
#[pyfunction]
#[pyo3(signature = (bearings, points3d, down_in_camera=None, down_in_world=None))]
pub(crate) fn up2p(
    bearings: &Bound<'_, PyAny>,
    points3d: &Bound<'_, PyAny>,
    down_in_camera: Option<&Bound<'_, PyAny>>,
    down_in_world: Option<&Bound<'_, PyAny>>,
) -> Result<Vec<CameraPose>> {
    let mut poses = ArrayVec::new();
    let unit = vectors::<2>("bearings", bearings)?.map(|b| b.normalize());
    veiloc_pose::solvers::up2p(
        &unit,
        &points(points3d)?,
        &gravity(down_in_camera, down_in_world)?,
        &mut poses,
    );
    Ok(found(poses))
}

/// Poses from four lines and a known vertical.
///
/// Args:
///     lines: `[4, 3]`, as for `p6lp`.
///     points3d: `[4, 3]`, map units.
///     down_in_camera, down_in_world: `[3]`, the vertical in both frames. Default: the second axis of each.
///
/// Returns:
///     At most 2 poses.
#[pyfunction]
#[pyo3(signature = (lines, points3d, down_in_camera=None, down_in_world=None))]
pub(crate) fn u4lp(
    lines: &Bound<'_, PyAny>,
    points3d: &Bound<'_, PyAny>,
    down_in_camera: Option<&Bound<'_, PyAny>>,
    down_in_world: Option<&Bound<'_, PyAny>>,
) -> Result<Vec<CameraPose>> {
    let mut poses = ArrayVec::new();
    let (points, gravity) = (points(points3d)?, gravity(down_in_camera, down_in_world)?);
    if let Some(lines) = self::lines(lines)? {
        veiloc_pose::solvers::u4lp(&lines, &points, &gravity, &mut poses);
    }
    Ok(found(poses))
}
