//! VisualSFM's models (`.nvm`), as in Aachen and Cambridge Landmarks.
//!
//! For each camera: `name focal qw qx qy qz cx cy cz distortion 0`; the quaternion rotates the world into the camera
//! (`x` right, `y` down), `c` its centre. For each point: position, colour, and the cameras that see it. A file may
//! hold several models with different world frames. Format: C. Wu, VisualSFM documentation.

use std::path::Path;

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::Point3;
use veiloc_geometry::frames::World;

use super::posed_input::{Poses, faulty};
use crate::error::MappingError;
use crate::importers::lines::{Line, pose_at};
use crate::importers::poses::names::ImageNames;
pub use crate::importers::poses::radial::radial_camera;

/// Number of fields after the name of a camera.
const CAMERA_FIELDS: usize = 10;

/// A camera of a model.
#[derive(Debug, Clone, PartialEq)]
pub struct NvmCamera {
    /// Name of its image.
    pub name: String,
    /// Focal length, pixels.
    pub focal: f64,
    /// `r` of `undistorted = measured (1 + r |measured|²)`, in units of the focal length.
    pub distortion: f64,
    /// Its pose.
    pub cam_from_world: CameraFromWorld,
    /// Indices of the points it sees, ascending.
    pub seen: Vec<u32>,
}

/// A model.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NvmModel {
    /// Its cameras, in the order of the file.
    pub cameras: Vec<NvmCamera>,
    /// Its points, model units.
    pub points: Vec<Point3<World>>,
    /// Number of cameras of further models in the file: they have other world frames, and are not read.
    pub left_out: usize,
}

impl NvmModel {
    /// A remark about further models in the file, if there are any.
    pub fn remark(&self) -> Option<String> {
        let n = self.left_out;
        (n > 0).then(|| {
            format!("{n} cameras of further models in the NVM file were left out: their world frames differ")
        })
    }
}

/// Reads the first model of a file.
///
/// # Errors
/// [`MappingError`] names file and line: not an NVM file, a fixed calibration, an invalid number, a truncated file,
/// or a point seen by a camera that does not exist.
pub fn read_nvm(path: &Path) -> Result<NvmModel, MappingError> {
    let bytes = std::fs::read(path).map_err(MappingError::io(path))?;
    // Names may be in any encoding; only names that other lists contain are used.
    parse(path, &String::from_utf8_lossy(&bytes))
}

/// Reads the first model of a file as posed images; their sizes are those of the image files.
pub(super) fn read(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let model = read_nvm(path)?;
    let mut poses = Poses { remarks: model.remark().into_iter().collect(), ..Poses::default() };
    for camera in &model.cameras {
        let Some((name, size)) = names.with_size(path, &camera.name)? else {
            poses.without_file.push(camera.name.clone());
            continue;
        };
        let intrinsics = radial_camera(camera.focal, camera.distortion, size);
        let intrinsics = intrinsics.map_err(|e| faulty(path, format!("{}: {e}", camera.name)))?;
        poses.push(name, intrinsics, camera.cam_from_world, camera.seen.clone());
    }
    poses.points = model.points;
    Ok(poses)
}

/// Parses the text of a file; errors name `path`.
///
/// # Errors
/// As [`read_nvm`].
pub fn parse(path: &Path, text: &str) -> Result<NvmModel, MappingError> {
    let mut lines = Line::all(path, text);
    let early = |what: &str| faulty(path, format!("ends before its {what}; get the file again"));
    let head = lines.next().ok_or_else(|| early("first line"))?;
    if head.words[0] != "NVM_V3" {
        return Err(head.fault("does not begin with NVM_V3, as VisualSFM's models do"));
    }
    if head.words.len() > 1 {
        return Err(head.fault(
            "has one calibration for all cameras, which is not supported; write the model without FixedK",
        ));
    }
    let mut model = NvmModel::default();
    let count: usize =
        lines.next().ok_or_else(|| early("number of cameras"))?.number(0, "the number of cameras")?;
    for _ in 0..count {
        model.cameras.push(camera(&lines.next().ok_or_else(|| early("cameras"))?)?);
    }
    let count: usize = lines.next().map_or(Ok(0), |line| line.number(0, "the number of points"))?;
    for id in 0..count {
        let line = lines.next().ok_or_else(|| early("points"))?;
        let id = u32::try_from(id).map_err(|_| line.fault("there are too many points"))?;
        let [x, y, z] = line.numbers(0, "a position")?;
        model.points.push(Point3::new(x, y, z));
        let seen: usize = line.number(6, "the number of measurements")?;
        for k in 0..seen {
            let camera: usize = line.number(7 + 4 * k, "a camera's number")?;
            let camera = model
                .cameras
                .get_mut(camera)
                .ok_or_else(|| line.fault(format!("is seen by camera {camera}, which does not exist")))?;
            if camera.seen.last() != Some(&id) {
                camera.seen.push(id);
            }
        }
    }
    // Further models follow, each with cameras and points; after a 0 only VisualSFM's own data follows.
    while let Some(line) = lines.next() {
        let count: usize = line.number(0, "the number of cameras of the next model")?;
        if count == 0 {
            break;
        }
        model.left_out = model.left_out.saturating_add(count);
        let mut rest = lines.by_ref().skip(count);
        let points: usize = rest.next().map_or(Ok(0), |line| line.number(0, "the number of points"))?;
        if points > 0 {
            rest.nth(points - 1);
        }
    }
    Ok(model)
}

fn camera(line: &Line<'_>) -> Result<NvmCamera, MappingError> {
    let at = line.words.len().checked_sub(CAMERA_FIELDS).filter(|at| *at > 0).ok_or_else(|| {
        line.fault("a camera needs name, focal length, quaternion, centre, distortion and 0")
    })?;
    let [focal] = line.numbers(at, "the focal length")?;
    let wxyz = line.numbers(at + 1, "the quaternion")?;
    let center = line.numbers(at + 5, "the centre")?;
    let [distortion] = line.numbers(at + 8, "the distortion")?;
    Ok(NvmCamera {
        name: line.words[..at].join(" "),
        focal,
        distortion,
        cam_from_world: pose_at(center, wxyz)
            .ok_or_else(|| line.fault("the quaternion is not a rotation"))?,
        seen: Vec::new(),
    })
}
