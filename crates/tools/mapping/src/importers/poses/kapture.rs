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
    // Those that cannot be used matter only if an image has them.
    let mut cameras: BTreeMap<&str, Result<Intrinsics, MappingError>> = BTreeMap::new();
    let mut poses = Poses::default();
    for line in Line::of_commas(&path, &content) {
        let [id, _, kind, model, ..] = line.words[..] else { continue };
        if kind != "camera" || model == "UNKNOWN_CAMERA" {
            continue;
        }
        let camera = line.number::<f64>(4, "the width").and_then(|w| {
            let h: f64 = line.number(5, "the height")?;
            let params = (6..line.words.len()).map(|at| line.number(at, "a parameter of the camera"));
            let params: Vec<f64> = params.collect::<Result<_, _>>()?;
            Intrinsics::new(model, w as u32, h as u32, &params).map_err(|e| line.fault(e.to_string()))
        });
        cameras.insert(id, camera);
    }

    let path = sensors_folder.join("rigs.txt");
    let content = if path.is_file() { text(&path)? } else { String::new() };
    // Of a sensor: the rig, and its pose in it.
    let mut rigs: BTreeMap<String, (String, CameraFromRig)> = BTreeMap::new();
    for line in Line::of_commas(&path, &content) {
        let [rig, sensor, ..] = line.words[..] else {
            poses.leave_out("sensors of rigs", &line.place(), "a rig needs its sensor");
            continue;
        };
        let pose = line.numbers(2, "the quaternion").and_then(|q| {
            let pose = CameraFromRig::from_quaternion(q, line.numbers(6, "the translation")?);
            pose.ok_or_else(|| line.fault("the quaternion is not a rotation"))
        });
        if let Some(pose) = poses.keep("sensors of rigs", sensor, pose)? {
            rigs.insert(sensor.to_owned(), (rig.to_owned(), pose));
        }
    }

    let path = sensors_folder.join("trajectories.txt");
    let content = text(&path)?;
    let mut trajectory = BTreeMap::new();
    for line in Line::of_commas(&path, &content) {
        let [time, device, rest @ ..] = &line.words[..] else {
            poses.leave_out("poses", &line.place(), "a pose needs time and device");
            continue;
        };
        // A position without an orientation, or the reverse, has empty fields.
        if rest.len() < 7 || rest.iter().take(7).any(|word| word.is_empty()) {
            poses.leave_out("poses", &line.place(), "they have no orientation or no position");
            continue;
        }
        let pose = line.numbers(2, "the quaternion").and_then(|q| {
            let t = line.numbers(6, "the translation")?;
            let is_pose = CameraFromWorld::from_quaternion(q, t).is_some();
            is_pose.then_some((q, t)).ok_or_else(|| line.fault("the quaternion is not a rotation"))
        });
        if let Some(pose) = poses.keep("poses", &line.place(), pose)? {
            trajectory.insert((*time, *device), pose);
        }
    }

    let path = sensors_folder.join("records_camera.txt");
    let content = text(&path)?;
    let records = sensors_folder.join("records_data/records_camera.txt");
    for line in Line::of_commas(&path, &content) {
        let [time, device, name @ ..] = &line.words[..] else {
            poses.leave_out("images", &line.place(), "an image needs time and camera");
            continue;
        };
        let name = name.join(",");
        let camera = match cameras.get(device) {
            Some(Ok(camera)) => camera,
            Some(Err(error)) => {
                poses.leave_out("images", &name, &error.to_string());
                continue;
            }
            None => {
                poses.leave_out("images", &name, "they are without a known camera");
                continue;
            }
        };
        let own = trajectory.get(&(*time, *device));
        let own = own.and_then(|(q, t)| CameraFromWorld::from_quaternion(*q, *t));
        let of_rig = rigs.get(*device).and_then(|(rig, cam_from_rig)| {
            let (q, t) = trajectory.get(&(*time, rig.as_str()))?;
            Some(cam_from_rig.compose(&RigFromWorld::from_quaternion(*q, *t)?))
        });
        let Some(pose) = own.or(of_rig) else {
            poses.leave_out("images", &name, "they are without a pose");
            continue;
        };
        poses.push(names.find(&records, &name), *camera, pose, Vec::new());
    }
    Ok(poses)
}
