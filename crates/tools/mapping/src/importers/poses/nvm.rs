//! VisualSFM's models (`.nvm`), as in Aachen and Cambridge Landmarks.
//!
//! For each camera: `name focal qw qx qy qz cx cy cz distortion 0`; the quaternion rotates the world into the camera
//! (`x` right, `y` down), `c` its centre. After `NVM_V3_R9T` it is `name focal R t distortion 0`: nine numbers of the rotation,
//! row by row, and `x_cam = R x_world + t`. For each point: position, colour, and the cameras that see it. A file may
//! hold several models with different world frames. Format: C. Wu, VisualSFM documentation; `NVM_V3_R9T`: C. Wu, Multicore
//! Bundle Adjustment, `util.h` (`LoadNVM`).

use std::path::Path;

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::Point3;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix3, Vector3};

use super::posed_input::{Poses, faulty};
use crate::error::MappingError;
use crate::importers::lines::{Line, pose_at};
use crate::importers::poses::names::ImageNames;
pub use crate::importers::poses::radial::radial_camera;

/// Number of fields after the name of a camera, besides those of its pose.
const CAMERA_FIELDS: usize = 3;

/// How a file writes poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum PoseFields {
    /// A quaternion and the centre.
    Quaternion = 7,
    /// A matrix and the translation.
    Matrix = 12,
}

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
    /// What of this model is left out because its line is odd.
    pub odd: Vec<OddLine>,
}

/// A camera or point that is left out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OddLine {
    /// What it is, in the plural.
    pub items: &'static str,
    /// Name of the image, or place of the point.
    pub name: String,
    /// What is odd in it.
    pub reason: String,
}

impl NvmModel {
    /// A remark about further models in the file, if there are any.
    pub fn remark(&self) -> Option<String> {
        let n = self.left_out;
        (n > 0).then(|| {
            format!("{n} cameras of further models in the NVM file were left out: their world frames differ")
        })
    }

    /// A remark about odd lines that were left out, if there are any.
    pub fn remark_on_odd(&self) -> Option<String> {
        let OddLine { items, name, reason } = self.odd.first()?;
        let n = self.odd.len();
        Some(format!(
            "{n} odd lines of the NVM file were left out; the first is of {items}, {name}: {reason}"
        ))
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
    let text = veiloc_map::text::text_of(bytes);
    parse(path, &text.unwrap_or_else(|error| String::from_utf8_lossy(error.as_bytes()).into_owned()))
}

/// Reads the first model of a file as posed images; their sizes are those of the image files.
pub(super) fn read(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let model = read_nvm(path)?;
    let mut poses = Poses { remarks: model.remark().into_iter().collect(), ..Poses::default() };
    for OddLine { items, name, reason } in &model.odd {
        poses.leave_out(items, name, reason);
    }
    for camera in &model.cameras {
        let found = poses.keep("images", &camera.name, names.with_size(path, &camera.name))?;
        let Some(found) = found else { continue };
        let Some((name, size)) = found else {
            poses.without_file.push(camera.name.clone());
            continue;
        };
        let intrinsics = radial_camera(camera.focal, camera.distortion, size);
        let intrinsics = intrinsics.map_err(|error| faulty(path, error.to_string()));
        if let Some(intrinsics) = poses.keep("images", &camera.name, intrinsics)? {
            poses.push(name, intrinsics, camera.cam_from_world, camera.seen.clone());
        }
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
    let fields = match head.words[0] {
        "NVM_V3" => PoseFields::Quaternion,
        "NVM_V3_R9T" => PoseFields::Matrix,
        _ => return Err(head.fault("does not begin with NVM_V3 or NVM_V3_R9T, as VisualSFM's models do")),
    };
    if head.words.len() > 1 {
        return Err(head.fault(
            "has one calibration for all cameras, which is not supported; write the model without FixedK",
        ));
    }
    let mut model = NvmModel::default();
    let count: usize =
        lines.next().ok_or_else(|| early("number of cameras"))?.number(0, "the number of cameras")?;
    let mut cameras = Vec::new();
    for _ in 0..count {
        let line = lines.next().ok_or_else(|| early("cameras"))?;
        let (name, camera) = camera(&line, fields)?;
        match camera {
            Ok(camera) => cameras.push(Some(camera)),
            Err(reason) => {
                model.odd.push(OddLine { items: "images", name, reason });
                cameras.push(None);
            }
        }
    }
    let count: usize = lines.next().map_or(Ok(0), |line| line.number(0, "the number of points"))?;
    for _ in 0..count {
        let line = lines.next().ok_or_else(|| early("points"))?;
        let id = u32::try_from(model.points.len()).map_err(|_| line.fault("there are too many points"))?;
        match line.numbers(0, "a position") {
            Ok([x, y, z]) => model.points.push(Point3::new(x, y, z)),
            Err(error) => {
                model.odd.push(OddLine { items: "points", name: line.place(), reason: reason_of(error) });
                continue;
            }
        }
        let seen: usize = line.number(6, "the number of measurements")?;
        for k in 0..seen {
            let camera: usize = line.number(7 + 4 * k, "a camera's number")?;
            let camera = cameras
                .get_mut(camera)
                .ok_or_else(|| line.fault(format!("is seen by camera {camera}, which does not exist")))?;
            if let Some(camera) = camera.as_mut().filter(|camera| camera.seen.last() != Some(&id)) {
                camera.seen.push(id);
            }
        }
    }
    model.cameras = cameras.into_iter().flatten().collect();
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

/// The name of a camera and the camera, or what is odd in it.
///
/// # Errors
/// The line has another number of fields.
fn camera(line: &Line<'_>, fields: PoseFields) -> Result<(String, Result<NvmCamera, String>), MappingError> {
    let of_pose = fields as usize;
    let at = line.words.len().checked_sub(CAMERA_FIELDS + of_pose).filter(|at| *at > 0).ok_or_else(|| {
        line.fault(match fields {
            PoseFields::Quaternion => "a camera needs name, focal length, quaternion, centre, distortion and 0",
            PoseFields::Matrix => {
                "a camera of NVM_V3_R9T needs name, focal length, 9 numbers of the rotation, translation, distortion and 0"
            }
        })
    })?;
    let name = line.words[..at].join(" ");
    let read = || {
        let [focal] = line.numbers(at, "the focal length")?;
        let pose = match fields {
            PoseFields::Quaternion => {
                pose_at(line.numbers(at + 5, "the centre")?, line.numbers(at + 1, "the quaternion")?)
            }
            PoseFields::Matrix => {
                let rotation = Matrix3::from_row_slice(&line.numbers::<9>(at + 1, "the rotation")?);
                let translation = Vector3::from(line.numbers::<3>(at + 10, "the translation")?);
                CameraFromWorld::from_matrix(rotation, translation)
            }
        };
        let [distortion] = line.numbers(at + 1 + of_pose, "the distortion")?;
        let cam_from_world = pose.ok_or_else(|| line.fault("the pose is no rotation"))?;
        Ok(NvmCamera { name: name.clone(), focal, distortion, cam_from_world, seen: Vec::new() })
    };
    let camera = read().map_err(reason_of);
    Ok((name, camera))
}

/// What is odd in a line, without its place.
fn reason_of(error: MappingError) -> String {
    match error {
        MappingError::PosesLine { reason, .. } => reason,
        other => other.to_string(),
    }
}
