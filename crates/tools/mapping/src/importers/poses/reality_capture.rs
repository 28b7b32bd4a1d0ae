//! RealityCapture's (RealityScan's) registration as CSV: "Internal/External camera parameters".
//!
//! Columns by the names of the first line: `#name, x, y, alt, heading, pitch, roll, f, px, py, k1, k2, k3, k4, t1, t2`. The
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

use super::cameras::Brown;
use super::names::ImageNames;
use super::posed_input::{Poses, down, faulty, pose_of_opengl, text};
use crate::error::MappingError;
use crate::importers::lines::Line;

/// Longer side of the frame of the focal length, millimetres.
const FRAME: f64 = 36.0;

/// Columns that a file must have.
pub(super) const COLUMNS: [&str; 8] = ["#name", "x", "y", "alt", "heading", "pitch", "roll", "f"];

pub(super) fn read(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let content = text(path)?;
    let head: Vec<&str> = content.lines().next().unwrap_or_default().split(',').map(str::trim).collect();
    let column = |name: &str| head.iter().position(|column| *column == name);
    let [name_at, x, y, alt, heading, pitch, roll, f] = COLUMNS.map(column);
    let place = |at: Option<usize>, what: usize| {
        at.ok_or_else(|| {
            faulty(path, format!("has no column {}; export internal and external parameters", COLUMNS[what]))
        })
    };
    let [x, y, alt, heading, pitch, roll, f] = [
        place(x, 1)?,
        place(y, 2)?,
        place(alt, 3)?,
        place(heading, 4)?,
        place(pitch, 5)?,
        place(roll, 6)?,
        place(f, 7)?,
    ];
    let name_at = place(name_at, 0)?;
    let mut poses = Poses { down: down(0.0, 0.0, -1.0), ..Poses::default() };
    let mut is_distorted = false;
    for line in Line::of_commas(path, &content) {
        let number = |at: usize| -> Result<f64, MappingError> { Ok(line.numbers::<1>(at, head[at])?[0]) };
        let or_zero = |name: &str| column(name).map_or(Ok(0.0), number);
        let written = line.words.get(name_at).copied().unwrap_or_default();
        let Some((name, size)) = names.with_size(path, written)? else {
            poses.without_file.push(written.to_owned());
            continue;
        };
        let turn = |axis, degrees: f64| Rotation3::from_axis_angle(&axis, degrees.to_radians());
        let rotation = turn(Vector3::z_axis(), -number(heading)?)
            * turn(Vector3::x_axis(), number(pitch)?)
            * turn(Vector3::y_axis(), number(roll)?);
        let mut matrix = Matrix4::identity();
        matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation.matrix());
        matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&Vector3::new(number(x)?, number(y)?, number(alt)?));
        let pose = pose_of_opengl(&matrix).ok_or_else(|| line.fault("the pose is no rotation"))?;
        let pixels = f64::from(size.0.max(size.1)) / FRAME;
        let offset = [or_zero("px")?, or_zero("py")?];
        let k = [or_zero("k1")?, or_zero("k2")?, or_zero("k3")?, or_zero("k4")?];
        let p = [or_zero("t1")?, or_zero("t2")?];
        is_distorted |= offset != [0.0; 2] || k != [0.0; 4] || p != [0.0; 2];
        let principal =
            [0.5 * f64::from(size.0) + offset[0] * pixels, 0.5 * f64::from(size.1) + offset[1] * pixels];
        let camera = Brown { size, focal: [number(f)? * pixels; 2], principal, k, p };
        poses.push(name, camera.intrinsics(path)?, pose, Vec::new());
    }
    if is_distorted {
        poses.remarks.push(
            "the principal point is taken in millimetres of a 36 mm frame and the distortion as OpenCV's, which \
             RealityCapture does not document; undistorted images are safer"
                .to_owned(),
        );
    }
    Ok(poses)
}
