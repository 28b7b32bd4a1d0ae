//! Estimates poses from correspondences with PoseLib's calling convention: points, lines of any direction, anchored
//! lines.

use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Anchor, Intrinsics, Pencils, Pinhole, PixelLine, Point3};
use veiloc_localization::answer_doubts;
use veiloc_pose::{
    Correspondences, FocalPrior, Gravity, PoseEstimate, PoseOptions, PoseProblem, PositionPrior,
    estimate_pose,
};
use veiloc_protocol::{LayoutTurn, Scheme};

use crate::answer::Doubt;
use crate::arrays;
use crate::blocking::interruptible_on_worker;
use crate::camera::{camera_of, undistorted};
use crate::errors::{BindingError, Result};
use crate::options::pose_options;
use crate::pose::CameraPose;

/// A pose and its `info` dictionary.
type Estimated<'py> = (CameraPose, Bound<'py, PyDict>);

/// Anchors and angles, `[N]` both.
type Anchored<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>);

/// Optional evidence beside the correspondences.
#[derive(Default)]
struct OptionalInputs<'a, 'py> {
    keypoints: Option<&'a Bound<'py, PyAny>>,
    prior: Option<&'a Bound<'py, PyAny>>,
    gravity: Option<&'a Bound<'py, PyAny>>,
    position: Option<&'a Bound<'py, PyAny>>,
    focal: &'a str,
}

/// Estimates the pose of a camera from 2D–3D point correspondences.
///
/// Args:
///     points2d: `[N, 2]` pixels of the distorted image (the centre of its first pixel is (0.5, 0.5)).
///     points3d: `[N, 3]` map units.
///     camera: `{"model", "width", "height", "params"}` with COLMAP's models, or `"MODEL,WIDTH,HEIGHT,PARAMS…"`.
///     ransac_opt: `max_iterations` (10000), `min_iterations` (200), `success_prob` (0.9999), `seed` (0),
///         `score` (`"likelihood"` or `"msac"`), `max_reproj_error` (pixels, 4; only with `"msac"`), `noise_px`
///         (pixels, 2; only with `"likelihood"`), `expected_inlier_ratio` (0.2), `fixed_iterations` (none),
///         `min_inliers` (10), `anchored_solver`.
///     bundle_opt: `estimate_noise` (True): estimate the noise from the inliers in the final refinement.
///     keypoints: `[N]` keypoint indices; give several correspondences of one keypoint the same index. Default: all
///         differ.
///     prior: `[N]` prior probabilities that a correspondence is right. Default: all equal.
///     gravity: `(down_in_camera [3], down_in_world [3])`, optionally with a standard deviation in degrees (2).
///     position: `(x, y, z, sd)`: approximate position of the camera and its standard deviation, map units.
///     focal: `"calibrated"`, `"exif"` or `"unknown"`: how well the focal length is known; it is estimated unless
///         calibrated.
///
/// Returns:
///     The pose and a dictionary: `inliers` `[N]` bool, `num_inliers`, `num_inlier_keypoints`, `inlier_ratio`,
///     `iterations`, `refinements`, `model_score` (lower is better), `noise_px`, `focal_scale`, `covariance` `[6, 6]`
///     (radians, then map units), `center_covariance` `[3, 3]`, `free_direction` (`[3]`, in which the position is
///     undetermined, else None), `state` (`"trusted"`, `"doubtful"` or `"not-found"`), `doubts`, `log_evidence`.
///
/// Raises:
///     InputError: a shape, a number or an option is invalid.
///     NotLocalizedError: the correspondences support no pose.
#[pyfunction]
#[pyo3(signature = (points2d, points3d, camera, ransac_opt=None, bundle_opt=None, *, keypoints=None, prior=None, gravity=None, position=None, focal="calibrated"))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub(crate) fn estimate_absolute_pose<'py>(
    py: Python<'py>,
    points2d: &Bound<'py, PyAny>,
    points3d: &Bound<'py, PyAny>,
    camera: &Bound<'py, PyAny>,
    ransac_opt: Option<&Bound<'py, PyDict>>,
    bundle_opt: Option<&Bound<'py, PyDict>>,
    keypoints: Option<&Bound<'py, PyAny>>,
    prior: Option<&Bound<'py, PyAny>>,
    gravity: Option<&Bound<'py, PyAny>>,
    position: Option<&Bound<'py, PyAny>>,
    focal: &str,
) -> Result<Estimated<'py>> {
    let camera = camera_of(camera)?;
    let pixels = undistorted(&camera, arrays::pixels("points2d", points2d)?)?;
    let known = OptionalInputs { keypoints, prior, gravity, position, focal };
    estimate(
        py,
        &camera,
        Correspondences::Points { pixels },
        points3d,
        &known,
        pose_options(ransac_opt, bundle_opt)?,
    )
}

/// Estimates the pose of a camera from 2D-line–3D-point correspondences.
///
/// Each line runs through the keypoint of its map point.
///
/// Args:
///     lines2d: `[N, 3]`, `a u + b v + c = 0` in pixels of the undistorted image, of any scale.
///     points3d, camera, ransac_opt, bundle_opt, keypoints, prior, gravity, position, focal: as for
///         `estimate_absolute_pose`.
///
/// Returns:
///     The pose and a dictionary, as for `estimate_absolute_pose`.
///
/// Raises:
///     InputError: a shape, a number or an option is invalid.
///     NotLocalizedError: the correspondences support no pose.
#[pyfunction]
#[pyo3(signature = (lines2d, points3d, camera, ransac_opt=None, bundle_opt=None, *, keypoints=None, prior=None, gravity=None, position=None, focal="calibrated"))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub(crate) fn estimate_absolute_pose_lines<'py>(
    py: Python<'py>,
    lines2d: &Bound<'py, PyAny>,
    points3d: &Bound<'py, PyAny>,
    camera: &Bound<'py, PyAny>,
    ransac_opt: Option<&Bound<'py, PyDict>>,
    bundle_opt: Option<&Bound<'py, PyDict>>,
    keypoints: Option<&Bound<'py, PyAny>>,
    prior: Option<&Bound<'py, PyAny>>,
    gravity: Option<&Bound<'py, PyAny>>,
    position: Option<&Bound<'py, PyAny>>,
    focal: &str,
) -> Result<Estimated<'py>> {
    let camera = camera_of(camera)?;
    let line = |(index, line): (usize, [f64; 3])| {
        PixelLine::from_homogeneous(Vector3::from(line)).ok_or_else(|| {
            BindingError::input(format_args!(
                "lines2d: line {index} is not a line (a and b are 0, or a number is not finite)"
            ))
        })
    };
    let lines = arrays::rows::<3>("lines2d", lines2d)?.into_iter().enumerate().map(line);
    let observations = Correspondences::Lines { lines: lines.collect::<Result<_>>()? };
    let known = OptionalInputs { keypoints, prior, gravity, position, focal };
    estimate(py, &camera, observations, points3d, &known, pose_options(ransac_opt, bundle_opt)?)
}

/// Estimates the pose of a camera from anchored lines (Dual Convergent Lines) and map points.
///
/// Each line runs through the keypoint of its map point.
///
/// Args:
///     anchors: `[N]`, index of each line's anchor, from 0.
///     angles: `[N]` radians, direction of each line at its anchor, as `anchored_lines` returns it.
///     points3d, camera, ransac_opt, bundle_opt, keypoints, prior, gravity, position, focal: as for
///         `estimate_absolute_pose`.
///     layout: `"dcl"` or `"dcl:..."`, the name of a scheme.
///     layout_focal: focal length of the layout, pixels, as `obfuscate` returns it. Default: the camera's.
///
/// Returns:
///     The pose and a dictionary, as for `estimate_absolute_pose`.
///
/// Raises:
///     InputError: a shape, a number or an option is invalid.
///     NotLocalizedError: the correspondences support no pose.
#[pyfunction]
#[pyo3(signature = (anchors, angles, points3d, camera, ransac_opt=None, bundle_opt=None, *, layout="dcl", layout_focal=None, keypoints=None, prior=None, gravity=None, position=None, focal="calibrated"))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub(crate) fn estimate_absolute_pose_anchored<'py>(
    py: Python<'py>,
    anchors: &Bound<'py, PyAny>,
    angles: &Bound<'py, PyAny>,
    points3d: &Bound<'py, PyAny>,
    camera: &Bound<'py, PyAny>,
    ransac_opt: Option<&Bound<'py, PyDict>>,
    bundle_opt: Option<&Bound<'py, PyDict>>,
    layout: &str,
    layout_focal: Option<f64>,
    keypoints: Option<&Bound<'py, PyAny>>,
    prior: Option<&Bound<'py, PyAny>>,
    gravity: Option<&Bound<'py, PyAny>>,
    position: Option<&Bound<'py, PyAny>>,
    focal: &str,
) -> Result<Estimated<'py>> {
    let camera = camera_of(camera)?;
    let pencils = pencils_of(&camera, layout, layout_focal)?;
    let anchors = arrays::numbers::<i64>("anchors", anchors)?;
    let angles = arrays::numbers::<f64>("angles", angles)?;
    if anchors.len() != angles.len() {
        let (a, b) = (anchors.len(), angles.len());
        return Err(BindingError::input(format_args!(
            "anchors: {a} anchors for {b} angles; give one for each line"
        )));
    }
    let anchor = |index: i64| {
        let anchor = usize::try_from(index).ok().and_then(Anchor::new).filter(|a| a.index() < pencils.len());
        anchor.ok_or_else(|| {
            BindingError::input(format_args!(
                "anchors: {index} is not an anchor; the layout has {}, counted from 0",
                pencils.len()
            ))
        })
    };
    let lines: Result<Vec<_>> =
        anchors.into_iter().zip(angles).map(|(index, angle)| Ok((anchor(index)?, angle))).collect();
    let observations = Correspondences::Anchored { lines: lines?, pencils };
    let known = OptionalInputs { keypoints, prior, gravity, position, focal };
    estimate(py, &camera, observations, points3d, &known, pose_options(ransac_opt, bundle_opt)?)
}

/// Anchor and unquantized angle of each keypoint under a layout of Dual Convergent Lines.
///
/// Args:
///     points2d: `[N, 2]` pixels of the distorted image.
///     camera: as for `estimate_absolute_pose`.
///     layout: `"dcl"` or `"dcl:..."`.
///
/// Returns:
///     `anchors` `[N]` (int64) and `angles` `[N]` radians in [0, 2π).
///
/// Raises:
///     InputError: a shape, a number or the layout is invalid.
#[pyfunction]
#[pyo3(signature = (points2d, camera, layout="dcl"))]
pub(crate) fn anchored_lines<'py>(
    py: Python<'py>,
    points2d: &Bound<'py, PyAny>,
    camera: &Bound<'py, PyAny>,
    layout: &str,
) -> Result<Anchored<'py>> {
    let camera = camera_of(camera)?;
    let pencils = pencils_of(&camera, layout, None)?;
    let pixels = undistorted(&camera, arrays::pixels("points2d", points2d)?)?;
    let line = |pixel| {
        let anchor = pencils.anchor_of(pixel);
        (anchor.index() as i64, pencils.angle_of(anchor, pixel))
    };
    let (anchors, angles): (Vec<i64>, Vec<f64>) = pixels.into_iter().map(line).unzip();
    Ok((anchors.into_pyarray(py), angles.into_pyarray(py)))
}

/// The anchors of a layout in a camera. Angles depend on the focal length, so it must be the one they were measured
/// with.
fn pencils_of(camera: &Intrinsics, layout: &str, focal: Option<f64>) -> Result<Pencils> {
    let Scheme::Dcl(layout) = layout.parse::<Scheme>()? else {
        return Err(BindingError::input(format_args!(
            "layout: {layout:?} has no anchors; give \"dcl\" or one of its layouts"
        )));
    };
    let own = camera.pinhole();
    let of = Pinhole { focal: focal.map_or(own.focal, |focal| [focal; 2]), ..own };
    let pencils = layout.pencils(&of, LayoutTurn::default());
    pencils
        .ok_or_else(|| BindingError::input("camera: no layout fits a camera of this size and focal length"))
}

fn estimate<'py>(
    py: Python<'py>,
    camera: &Intrinsics,
    observations: Correspondences,
    points3d: &Bound<'py, PyAny>,
    known: &OptionalInputs<'_, 'py>,
    (options, seed): (PoseOptions, u64),
) -> Result<Estimated<'py>> {
    let points = arrays::points("points3d", points3d)?;
    let keypoints = match known.keypoints {
        Some(keypoints) => arrays::numbers::<i64>("keypoints", keypoints)?
            .into_iter()
            .map(|k| {
                usize::try_from(k).map_err(|_| BindingError::input("keypoints: indices must be 0 or more"))
            })
            .collect::<Result<_>>()?,
        None => (0..points.len()).collect(),
    };
    let mut problem = PoseProblem::new(camera.pinhole(), observations, keypoints, points);
    problem.prior = known.prior.map(|prior| arrays::numbers::<f64>("prior", prior)).transpose()?;
    problem.gravity = known.gravity.map(gravity_of).transpose()?;
    problem.position = known.position.map(position_of).transpose()?;
    problem.focal =
        match known.focal.parse::<veiloc_protocol::FocalKnowledge>().map_err(BindingError::input)? {
            veiloc_protocol::FocalKnowledge::Calibrated => FocalPrior::Calibrated,
            veiloc_protocol::FocalKnowledge::Exif => FocalPrior::Exif,
            veiloc_protocol::FocalKnowledge::Unknown => FocalPrior::Unknown,
        };
    let stop = options.stop.clone();
    let found = interruptible_on_worker(py, &stop, move || {
        estimate_pose(&problem, &options, &mut ChaCha8Rng::seed_from_u64(seed))
    })??;
    Ok((found.cam_from_world.into(), info(py, &found)?))
}

fn gravity_of(gravity: &Bound<'_, PyAny>) -> Result<Gravity> {
    let refused = || {
        BindingError::input(
            "gravity: must be (down_in_camera [3], down_in_world [3]), optionally followed by a standard deviation in degrees",
        )
    };
    let parts: Vec<Bound<'_, PyAny>> = gravity.try_iter().map_err(|_| refused())?.collect::<PyResult<_>>()?;
    let (camera, world, sd_deg) = match parts.as_slice() {
        [camera, world] => (camera, world, Gravity::PHONE_SD_DEG),
        [camera, world, sd] => (camera, world, sd.extract::<f64>().map_err(|_| refused())?),
        _ => return Err(refused()),
    };
    let in_camera = Vector3::from(arrays::vector::<3>("gravity", camera)?);
    let in_world = Vector3::from(arrays::vector::<3>("gravity", world)?);
    Ok(Gravity { in_camera, in_world, sd_deg })
}

/// A position prior from `(x, y, z, sd)`.
pub(crate) fn position_of(position: &Bound<'_, PyAny>) -> Result<PositionPrior> {
    let [x, y, z, sd] = arrays::vector::<4>("position", position)?;
    Ok(PositionPrior { center: Point3::new(x, y, z), sd })
}

fn info<'py>(py: Python<'py>, found: &PoseEstimate) -> PyResult<Bound<'py, PyDict>> {
    let info = PyDict::new(py);
    let count = found.inliers.len().max(1);
    info.set_item("inliers", found.inliers.clone().into_pyarray(py))?;
    info.set_item("num_inliers", found.inlier_count)?;
    info.set_item("num_inlier_keypoints", found.inlier_keypoints)?;
    info.set_item("inlier_ratio", found.inlier_count as f64 / count as f64)?;
    info.set_item("iterations", found.hypotheses)?;
    info.set_item("refinements", usize::from(found.refined))?;
    info.set_item("model_score", found.score)?;
    info.set_item("noise_px", found.noise_px)?;
    info.set_item("focal_scale", found.focal_scale)?;
    info.set_item("covariance", arrays::matrix(py, found.covariance.into_iter())?)?;
    info.set_item("center_covariance", arrays::matrix(py, found.center_covariance().into_iter())?)?;
    info.set_item("free_direction", found.free_direction.map(|d| d.to_vec().into_pyarray(py)))?;
    info.set_item("state", found.confidence.state().to_string())?;
    info.set_item("log_evidence", found.confidence.log_evidence)?;
    let doubts: Vec<Doubt> = answer_doubts(&found.confidence).iter().map(Doubt::of).collect();
    info.set_item("doubts", doubts)?;
    Ok(info)
}
