//! A kapture folder: `sensors/sensors.txt`, `records_camera.txt`, `trajectories.txt`, and `rigs.txt` if there are rigs.
//!
//! Fields are separated by commas. `trajectories.txt` has `timestamp, device, qw, qx, qy, qz, tx, ty, tz`: world to
//! device, `x_device = R x_world + t`. A device is a camera or a rig; `rigs.txt` has `rig, sensor, qw, …, tz`, rig to sensor.
//! Cameras are COLMAP's models: `sensor, name, camera, MODEL, w, h, parameters`; `UNKNOWN_CAMERA` is left out. Image paths are
//! relative to `sensors/records_data`.
//!
//! Source: kapture, `kapture_format.adoc` (naver/kapture).

use std::collections::BTreeMap;
use std::path::Path;

use veiloc_geometry::{CameraFromRig, CameraFromWorld, Intrinsics, RigFromWorld};

use super::names::ImageNames;
use super::posed_input::{Poses, text};
use crate::error::MappingError;
use crate::importers::lines::Line;

pub(super) fn read(folder: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let sensors_folder = folder.join("sensors");
    let path = sensors_folder.join("sensors.txt");
    let content = text(&path)?;
    let mut cameras: BTreeMap<&str, Intrinsics> = BTreeMap::new();
    let mut poses = Poses::default();
    for line in Line::of_commas(&path, &content) {
        let [id, _, kind, model, ..] = line.words[..] else { continue };
        if kind != "camera" || model == "UNKNOWN_CAMERA" {
            continue;
        }
        let (w, h): (f64, f64) = (line.number(4, "the width")?, line.number(5, "the height")?);
        let params = (6..line.words.len()).map(|at| line.number(at, "a parameter of the camera"));
        let params: Vec<f64> = params.collect::<Result<_, _>>()?;
        let camera =
            Intrinsics::new(model, w as u32, h as u32, &params).map_err(|e| line.fault(e.to_string()))?;
        cameras.insert(id, camera);
    }

    let path = sensors_folder.join("rigs.txt");
    let content = if path.is_file() { text(&path)? } else { String::new() };
    // Of a sensor: the rig, and its pose in it.
    let mut rigs: BTreeMap<String, (String, CameraFromRig)> = BTreeMap::new();
    for line in Line::of_commas(&path, &content) {
        let [rig, sensor, ..] = line.words[..] else { return Err(line.fault("a rig needs its sensor")) };
        let pose = CameraFromRig::from_quaternion(
            line.numbers(2, "the quaternion")?,
            line.numbers(6, "the translation")?,
        )
        .ok_or_else(|| line.fault("the quaternion is not a rotation"))?;
        rigs.insert(sensor.to_owned(), (rig.to_owned(), pose));
    }

    let path = sensors_folder.join("trajectories.txt");
    let content = text(&path)?;
    let mut trajectory = BTreeMap::new();
    let mut partial = 0;
    for line in Line::of_commas(&path, &content) {
        let [time, device, rest @ ..] = &line.words[..] else {
            return Err(line.fault("a pose needs time and device"));
        };
        // A position without an orientation, or the reverse, has empty fields.
        if rest.len() < 7 || rest.iter().take(7).any(|word| word.is_empty()) {
            partial += 1;
            continue;
        }
        let pose = (line.numbers(2, "the quaternion")?, line.numbers(6, "the translation")?);
        if CameraFromWorld::from_quaternion(pose.0, pose.1).is_none() {
            return Err(line.fault("the quaternion is not a rotation"));
        }
        trajectory.insert((*time, *device), pose);
    }
    if partial > 0 {
        poses.remarks.push(format!("{partial} poses without an orientation or a position are left out"));
    }

    let path = sensors_folder.join("records_camera.txt");
    let content = text(&path)?;
    let (mut no_camera, mut no_pose) = (0, 0);
    let records = sensors_folder.join("records_data/records_camera.txt");
    for line in Line::of_commas(&path, &content) {
        let [time, device, name @ ..] = &line.words[..] else {
            return Err(line.fault("an image needs time and camera"));
        };
        let name = name.join(",");
        let Some(camera) = cameras.get(device) else {
            no_camera += 1;
            continue;
        };
        let own = trajectory.get(&(*time, *device));
        let own = own.and_then(|(q, t)| CameraFromWorld::from_quaternion(*q, *t));
        let of_rig = rigs.get(*device).and_then(|(rig, cam_from_rig)| {
            let (q, t) = trajectory.get(&(*time, rig.as_str()))?;
            Some(cam_from_rig.compose(&RigFromWorld::from_quaternion(*q, *t)?))
        });
        let Some(pose) = own.or(of_rig) else {
            no_pose += 1;
            continue;
        };
        poses.push(names.find(&records, &name), *camera, pose, Vec::new());
    }
    if no_camera > 0 {
        poses.remarks.push(format!("{no_camera} images without a known camera are left out"));
    }
    if no_pose > 0 {
        poses.remarks.push(format!("{no_pose} images without a pose are left out"));
    }
    Ok(poses)
}
