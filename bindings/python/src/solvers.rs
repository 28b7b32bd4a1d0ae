//! The minimal solvers, each by its name (PoseLib's grammar): a sample in, all poses that explain it out.
//!
//! A degenerate sample, or one that is not finite, has no poses: that is no error.

use pyo3::prelude::*;
use veiloc_geometry::nalgebra::{Vector2, Vector3};
use veiloc_geometry::{CameraFromWorld, PlaneLine, Point3, frames::World};
use veiloc_pose::solvers::{ArrayVec, GravityAlignment, HalfPlane};

use crate::arrays;
use crate::errors::{Fault, Result};
use crate::pose::CameraPose;

/// Down along the camera's and the world's second axis, as PoseLib's upright solvers have it.
const DOWN: [f64; 3] = [0.0, 1.0, 0.0];

fn points<const N: usize>(array: &Bound<'_, PyAny>) -> Result<[Point3<World>; N]> {
    Ok(arrays::sample::<N, 3>("points3d", array)?.map(|[x, y, z]| Point3::new(x, y, z)))
}

fn vectors<const N: usize>(what: &str, array: &Bound<'_, PyAny>) -> Result<[Vector3<f64>; N]> {
    Ok(arrays::sample::<N, 3>(what, array)?.map(Vector3::from))
}

/// Lines of the plane `z = 1`, of any scale; `None` when one is none.
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
    alignment
        .ok_or_else(|| Fault::input("down_in_camera, down_in_world: vectors with a direction are needed"))
}

fn found<const N: usize>(poses: ArrayVec<CameraFromWorld, N>) -> Vec<CameraPose> {
    poses.into_iter().map(CameraPose).collect()
}

/// Poses from three points: `bearings` `[3, 3]` of any length in the camera, `points3d` `[3, 3]`. At most 4.
#[pyfunction]
pub(crate) fn p3p(bearings: &Bound<'_, PyAny>, points3d: &Bound<'_, PyAny>) -> Result<Vec<CameraPose>> {
    let mut poses = ArrayVec::new();
    let unit = vectors::<3>("bearings", bearings)?.map(|b| b.normalize());
    veiloc_pose::solvers::p3p(&unit, &points(points3d)?, &mut poses);
    Ok(found(poses))
}

/// Poses from six lines: `lines` `[6, 3]`, lines of the plane z = 1 (`Kᵀ l` of a line `l` in pixels), `points3d` `[6, 3]`. At
/// most 8.
#[pyfunction]
pub(crate) fn p6lp(lines: &Bound<'_, PyAny>, points3d: &Bound<'_, PyAny>) -> Result<Vec<CameraPose>> {
    let mut poses = ArrayVec::new();
    let points = points(points3d)?;
    if let Some(lines) = self::lines(lines)? {
        veiloc_pose::solvers::p6lp(&lines, &points, &mut poses);
    }
    Ok(found(poses))
}

/// Poses from five half-lines that begin in one point of the image, up to the depth along its ray: `directions` `[5, 2]` in
/// a camera turned so that the ray is its z axis, `points3d` `[5, 3]`. At most 4, with `t[2] = 0`.
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

/// Poses from five half-planes of one anchor and one of another: `anchor` `[3]`, the direction at which the five begin,
/// `inward` `[5, 3]`, where each leads from there, `sixth_axis` `[3]` and `sixth_inward` `[3]` of the sixth, `points3d`
/// `[6, 3]`; directions of the camera's frame, of any length. At most 4.
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

/// Poses from two points and the vertical: `bearings` `[2, 3]`, `points3d` `[2, 3]`, and one direction in both frames
/// (default: the second axis of each). At most 2.
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

/// Poses from four lines and the vertical: `lines` `[4, 3]` as of `p6lp`, `points3d` `[4, 3]`, and one direction in both
/// frames (default: the second axis of each). At most 2.
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
