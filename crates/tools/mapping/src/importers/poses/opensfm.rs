//! `reconstruction.json` of OpenSfM, OpenDroneMap and Mapillary: an array of reconstructions with `cameras`, `shots`,
//! `points` and `reference_lla`.
//!
//! A shot's pose is world to camera, `rotation` an axis times an angle, `translation` `t`: `x_cam = R x_world + t`, axes
//! right, down, forward. Focal lengths and principal points are in units of the longer side, from the middle of the image.
//! `perspective`, `simple_radial`, `radial` and `brown` are Brown's distortion, `fisheye` and `fisheye_opencv` that of
//! OpenCV's fisheye. Shots of panoramas (`spherical`) are left out. With `reference_lla` the world is east, north, up
//! about that position, metres. Of several reconstructions, whose frames differ, the one with the most shots is read.
//!
//! Source: OpenSfM documentation, "Dataset structure" (reconstruction file format) and "Geometric models"
//! (`doc/source/geometry.rst`).

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Point3};

use super::cameras::{Brown, intrinsics};
use super::json::{Json, document};
use super::names::ImageNames;
use super::posed_input::{Poses, down};
use crate::error::MappingError;

pub(super) fn read(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let value = document(path)?;
    let all = Json { path, value: &value, place: "" };
    let parts = value.as_array().map(Vec::as_slice).unwrap_or_default();
    let shots_of =
        |part: &Value| part.get("shots").and_then(Value::as_object).map_or(0, serde_json::Map::len);
    // Of equally large ones the first.
    let largest = parts.iter().rev().max_by_key(|part| shots_of(part));
    let part = largest.ok_or_else(|| all.fault("has no reconstruction"))?;
    let mut poses = Poses::default();
    let others: usize = parts.iter().map(shots_of).sum::<usize>() - shots_of(part);
    if others > 0 {
        poses.remarks.push(format!(
            "{others} images of {} further reconstructions are left out: their world frames differ",
            parts.len() - 1
        ));
    }
    let mut cameras: BTreeMap<&str, Option<Intrinsics>> = BTreeMap::new();
    for (id, camera) in part.get("cameras").and_then(Value::as_object).into_iter().flatten() {
        let place = format!("camera {id}");
        cameras.insert(id, read_camera(&Json { path, value: camera, place: &place })?);
    }
    let mut panoramas = 0;
    for (written, shot) in part.get("shots").and_then(Value::as_object).into_iter().flatten() {
        let place = format!("shot {written}");
        let shot = Json { path, value: shot, place: &place };
        let camera = shot.text("camera")?;
        let camera =
            cameras.get(camera).ok_or_else(|| shot.fault(format!("its camera {camera:?} is missing")))?;
        let Some(camera) = camera else {
            panoramas += 1;
            continue;
        };
        let rotation = Rotation3::new(Vector3::from(shot.array::<3>("rotation")?));
        let pose = CameraFromWorld::new(rotation, Vector3::from(shot.array::<3>("translation")?));
        poses.push(names.find(path, written), *camera, pose, Vec::new());
    }
    if panoramas > 0 {
        poses.remarks.push(format!("{panoramas} panoramas are left out: they have no pinhole image"));
    }
    for (id, point) in part.get("points").and_then(Value::as_object).into_iter().flatten() {
        let place = format!("point {id}");
        let position = Json { path, value: point, place: &place }.array::<3>("coordinates")?;
        poses.points.push(Point3::from_vector(Vector3::from(position)));
    }
    // Models of images without GPS have a reference of zeros.
    let is_on_earth = |reference: &Value| {
        ["latitude", "longitude"]
            .iter()
            .any(|key| reference.get(key).and_then(Value::as_f64).is_some_and(|x| x != 0.0))
    };
    if part.get("reference_lla").is_some_and(is_on_earth) {
        poses.down = down(0.0, 0.0, -1.0);
    }
    Ok(poses)
}

/// A camera; `None` for a panorama.
fn read_camera(camera: &Json<'_>) -> Result<Option<Intrinsics>, MappingError> {
    let path = camera.path;
    let size = (camera.needed("width")? as u32, camera.needed("height")? as u32);
    let side = f64::from(size.0.max(size.1));
    let or_zero = |key: &str| camera.number(key).map(|number| number.unwrap_or(0.0));
    let model = camera.text("projection_type")?;
    if matches!(model, "spherical" | "equirectangular") {
        return Ok(None);
    }
    let fx = match camera.number("focal_x")? {
        Some(focal) => focal,
        None => camera.needed("focal")?,
    };
    let fy = camera.number("focal_y")?.unwrap_or(fx);
    let focal = [fx * side, fy * side];
    let principal =
        [or_zero("c_x")? * side + 0.5 * f64::from(size.0), or_zero("c_y")? * side + 0.5 * f64::from(size.1)];
    let k = [or_zero("k1")?, or_zero("k2")?, or_zero("k3")?, or_zero("k4")?];
    match model {
        "perspective" | "simple_radial" | "radial" | "brown" => {
            let p = [or_zero("p1")?, or_zero("p2")?];
            Brown { size, focal, principal, k, p }.intrinsics(path).map(Some)
        }
        "fisheye" | "fisheye_opencv" => {
            let params = [focal[0], focal[1], principal[0], principal[1], k[0], k[1], k[2], k[3]];
            intrinsics(path, "OPENCV_FISHEYE", size, &params).map(Some)
        }
        other => Err(camera.fault(format!(
            "its projection_type is {other:?}; perspective, simple_radial, radial, brown, fisheye and fisheye_opencv are \
             read"
        ))),
    }
}
