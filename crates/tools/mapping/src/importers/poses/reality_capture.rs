//! RealityCapture's (RealityScan's) registration as CSV: "Internal/External camera parameters".
//!
//! Columns by the names of the first line, separated by commas, or by semicolons or tabs with decimal commas or points: `#name, x, y, alt, heading, pitch, roll, f, px, py, k1, k2, k3, k4, t1, t2`. The
//! world is east, north, up. Camera to world is `R_z(−heading) R_x(pitch) R_y(roll)`, degrees, for camera axes right, up,
//! backward: with all three 0 the camera looks down and its top is north. `f` is in millimetres of a frame whose longer side is
//! 36 mm; `px`, `py` likewise, from the middle of the image. Distortion is Brown's; `t1`, `t2` are taken as OpenCV's `p1`,
//! `p2`.
//!
//! The program's documentation states neither the unit of `px`, `py` nor the direction of the distortion; a remark says so
//! if they are not 0.
//!
//! Source: `nerfstudio/process_data/realitycapture_utils.py` (rotation, focal length, distortion).

use std::path::Path;

use veiloc_geometry::nalgebra::{Matrix4, Rotation3, Vector3};

use super::cameras::Lens;
use super::names::ImageNames;
use super::posed_input::{Poses, down, faulty, pose_of_opengl, text};
use crate::error::MappingError;
use crate::importers::lines::Line;

/// Longer side of the frame of the focal length, millimetres.
const FRAME: f64 = 36.0;

/// Columns that a file must have.
const COLUMNS: [&str; 8] = ["#name", "x", "y", "alt", "heading", "pitch", "roll", "f"];

/// The separator of a file with this first line, and its columns; `None` if it is not RealityCapture's.
pub(super) fn columns(first: &str) -> Option<(char, Vec<&str>)> {
    [',', ';', '\t'].into_iter().find_map(|separator| {
        let columns: Vec<&str> = first.split(separator).map(str::trim).collect();
        (columns.len() > 4 && COLUMNS[..4].iter().all(|column| columns.contains(column)))
            .then_some((separator, columns))
    })
}

pub(super) fn read(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let content = text(path)?;
    let first = content.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
    let (separator, head) = columns(first).ok_or_else(|| faulty(path, "has no columns #name, x, y, alt"))?;
    let column = |name: &str| head.iter().position(|column| *column == name);
    let mut at = [0; COLUMNS.len()];
    for (at, name) in at.iter_mut().zip(COLUMNS) {
        *at = column(name).ok_or_else(|| {
            faulty(path, format!("has no column {name}; export internal and external parameters"))
        })?;
    }
    let [name_at, x, y, alt, heading, pitch, roll, f] = at;
    let mut poses = Poses { down: down(0.0, 0.0, -1.0), ..Poses::default() };
    let mut is_distorted = false;
    for line in Line::of_fields(path, &content, separator) {
        let number = |at: usize| -> Result<f64, MappingError> {
            // Where commas do not separate fields they are decimal points.
            let word = line.words.get(at).copied().unwrap_or_default().replace(',', ".");
            let number = word.parse().ok().filter(|number: &f64| number.is_finite());
            number
                .ok_or_else(|| line.fault(format!("{} is {word:?}, which is not a finite number", head[at])))
        };
        let or_zero = |name: &str| column(name).map_or(Ok(0.0), number);
        let written = line.words.get(name_at).copied().unwrap_or_default();
        let Some(found) = poses.keep("images", written, names.with_size(path, written))? else { continue };
        let Some((name, size)) = found else {
            poses.without_file.push(written.to_owned());
            continue;
        };
        let turn = |axis, degrees: f64| Rotation3::from_axis_angle(&axis, degrees.to_radians());
        let pixels = f64::from(size.0.max(size.1)) / FRAME;
        let posed = number(heading).and_then(|heading| {
            let rotation = turn(Vector3::z_axis(), -heading)
                * turn(Vector3::x_axis(), number(pitch)?)
                * turn(Vector3::y_axis(), number(roll)?);
            let mut matrix = Matrix4::identity();
            matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation.matrix());
            matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&Vector3::new(
                number(x)?,
                number(y)?,
                number(alt)?,
            ));
            let pose = pose_of_opengl(&matrix).ok_or_else(|| line.fault("the pose is no rotation"))?;
            let offset = [or_zero("px")?, or_zero("py")?];
            let k = [or_zero("k1")?, or_zero("k2")?, or_zero("k3")?, or_zero("k4")?];
            let p = [or_zero("t1")?, or_zero("t2")?, 0.0, 0.0];
            is_distorted |= offset != [0.0; 2] || k != [0.0; 4] || p != [0.0; 4];
            let principal =
                [0.5 * f64::from(size.0) + offset[0] * pixels, 0.5 * f64::from(size.1) + offset[1] * pixels];
            let lens = Lens { size, focal: [number(f)? * pixels; 2], principal, k, p, ..Lens::default() };
            Ok((lens.intrinsics(path)?, pose))
        });
        if let Some((camera, pose)) = poses.keep("images", &line.place(), posed)? {
            poses.push(name, camera, pose, Vec::new());
        }
    }
    if is_distorted {
        poses.remarks.push(
            "the principal point is taken in millimetres of a 36 mm frame and the distortion as OpenCV's, which \
             RealityCapture does not document; undistorted images are safer"
                .to_owned(),
        );
    }
    if let Some(remark) = degrees(&poses) {
        poses.remarks.push(remark);
    }
    Ok(poses)
}

/// A remark if `x` and `y` look like degrees of longitude and latitude, beside heights in metres.
fn degrees(poses: &Poses) -> Option<String> {
    let centers: Vec<[f64; 3]> =
        poses.images.iter().map(|image| image.cam_from_world.center().coords.into()).collect();
    let range = |axis: usize| {
        let values = || centers.iter().map(|center| center[axis]);
        let (least, most) =
            (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        (most - least, least.abs().max(most.abs()))
    };
    let [(x, far_x), (y, far_y), (alt, _)] = [0, 1, 2].map(range);
    // A degree is 111 km: ten metres are a ten-thousandth.
    let is_degrees = far_x <= 180.0 && far_y <= 90.0 && x.max(y) < 0.01 && alt > 20.0 * x.max(y);
    (is_degrees && far_x.max(far_y) > 100.0 * x.max(y)).then(|| {
        format!(
            "x and y differ by {:.6} only, alt by {alt:.3}: they may be degrees of longitude and latitude; export in a \
             coordinate system in metres (local, or UTM)",
            x.max(y)
        )
    })
}
