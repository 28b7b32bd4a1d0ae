//! A sequence of EuRoC (ASL's format): `mav0/cam0/sensor.yaml`, `mav0/cam0/data.csv`, and the poses of the body in
//! `mav0/state_groundtruth_estimate0/data.csv`.
//!
//! A pose is `time, x, y, z, qw, qx, qy, qz, …`: the body in the world, nanoseconds; `T_BS` of `sensor.yaml` is camera to body,
//! 4 × 4 row by row. Camera axes are right, down, forward. `distortion_model` is `radial-tangential` (OpenCV's `k1 k2 p1 p2`)
//! or `equidistant` (OpenCV's fisheye). Pixels count from the centre of the first one, so half a pixel is added. The camera is
//! `cam0`, or the one in whose folder the images are. Poses are interpolated at the times of the images.
//!
//! Source: M. Burri et al., *The EuRoC micro aerial vehicle datasets*, IJRR 2016, section 5 ("Data format").

use std::path::{Path, PathBuf};

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Isometry3, Translation3, UnitQuaternion};

use super::names::ImageNames;
use super::posed_input::{Poses, faulty, pose_of_world_from_cam, text};
use super::sensor_yaml::Sensor;
use super::times::{Stamped, pose_images, seconds_of, tracked};
use crate::error::MappingError;
use crate::importers::lines::Line;

/// The file of poses below `mav0`.
const POSES: &str = "state_groundtruth_estimate0/data.csv";

pub(super) fn read(folder: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let camera_folder = camera_folder(folder, names);
    let sensor_file = camera_folder.join("sensor.yaml");
    let sensor = Sensor { path: &sensor_file, name: "", content: &text(&sensor_file)? };
    let camera = sensor.intrinsics("distortion_coefficients")?;
    let cam_from_body = pose_of_world_from_cam(&sensor.matrix("data")?);
    let cam_from_body =
        cam_from_body.ok_or_else(|| faulty(&sensor_file, "T_BS is no rotation and translation"))?;

    let path = folder.join(POSES);
    let content = text(&path)?;
    let mut poses = Poses::default();
    let mut trajectory = Vec::new();
    for line in Line::of_commas(&path, &content) {
        let pose = nanoseconds(&line).and_then(|time| {
            let pose =
                Stamped::new(time, line.numbers(4, "the quaternion")?, line.numbers(1, "the position")?);
            pose.ok_or_else(|| line.fault("the quaternion is not a rotation"))
        });
        trajectory.extend(poses.keep("poses", &line.place(), pose)?);
    }
    let trajectory = tracked(trajectory, &mut poses);

    let path = camera_folder.join("data.csv");
    let content = text(&path)?;
    let in_camera_folder = camera_folder.join("data/data.csv");
    let mut images = Vec::new();
    for line in Line::of_commas(&path, &content) {
        let image = nanoseconds(&line).and_then(|time| {
            let written = line.words.get(1).copied().ok_or_else(|| line.fault("the file name is missing"))?;
            Ok((time, names.find(&in_camera_folder, written)))
        });
        images.extend(poses.keep("images", &line.place(), image)?);
    }
    pose_images(&mut poses, &trajectory, &images, camera, |body| composed(&cam_from_body, body));
    Ok(poses)
}

/// `cam_from_body * body_from_world`.
fn composed(cam_from_body: &CameraFromWorld, body: &Stamped) -> CameraFromWorld {
    let world_from_body = Isometry3::from_parts(Translation3::from(body.position), body.rotation);
    let body_from_world = world_from_body.inverse();
    let rotation = cam_from_body.rotation() * UnitQuaternion::to_rotation_matrix(body_from_world.rotation);
    let translation =
        cam_from_body.rotation() * body_from_world.translation.vector + cam_from_body.translation();
    CameraFromWorld::new(rotation, translation)
}

/// The folder of the camera whose images these are, or else of the first camera.
fn camera_folder(folder: &Path, names: &ImageNames) -> PathBuf {
    let images = names.folder().canonicalize().unwrap_or_else(|_| names.folder().to_owned());
    let cameras = (0..8).map(|n| folder.join(format!("cam{n}")));
    let holds = |camera: &PathBuf| camera.canonicalize().is_ok_and(|camera| images.starts_with(camera));
    cameras.into_iter().find(holds).unwrap_or_else(|| folder.join("cam0"))
}

/// The time of a line, in seconds after the first second of its nanoseconds.
fn nanoseconds(line: &Line<'_>) -> Result<f64, MappingError> {
    // An integer first: a double has 100 ns only.
    match line.number::<i64>(0, "the time") {
        Ok(time) => Ok(1e-9 * time as f64),
        // Others write decimals, or seconds.
        Err(error) => line.numbers(0, "the time").map_err(|_| error).map(|[time]| seconds_of(time)),
    }
}
