//! `reconstruction.json` of OpenSfM, OpenDroneMap and Mapillary: an array of reconstructions with `cameras`, `shots`,
//! `points` and `reference_lla`.
//!
//! A shot's pose is world to camera, `rotation` an axis times an angle, `translation` `t`: `x_cam = R x_world + t`, axes
//! right, down, forward. Focal lengths and principal points are in units of the longer side, from the middle of the image.
//! `perspective`, `simple_radial`, `radial` and `brown` are Brown's distortion, `fisheye` and `fisheye_opencv` that of
//! OpenCV's fisheye. Shots of panoramas (`spherical`) and of
//! other cameras are left out. With `reference_lla` the world is east, north, up
//! about that position, metres. Of several reconstructions, whose frames differ, the one with the most shots is read.
//!
//! Source: OpenSfM documentation, "Dataset structure" (reconstruction file format) and "Geometric models"
//! (`doc/source/geometry.rst`).

use std::path::Path;

use serde_json::Value;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Point3};

use super::cameras::Lens;
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
    let cameras = part.get("cameras");
    for (written, shot) in part.get("shots").and_then(Value::as_object).into_iter().flatten() {
        let place = format!("shot {written}");
        let shot = Json { path, value: shot, place: &place };
        let posed = shot.text("camera").and_then(|id| {
            let camera = cameras.and_then(|cameras| cameras.get(id));
            let camera = camera.ok_or_else(|| shot.fault(format!("its camera {id:?} is missing")))?;
            let camera = read_camera(&Json { path, value: camera, place: &format!("camera {id}") })?;
            let rotation = Rotation3::new(Vector3::from(shot.array::<3>("rotation")?));
            Ok((camera, CameraFromWorld::new(rotation, Vector3::from(shot.array::<3>("translation")?))))
        });
        if let Some((camera, pose)) = poses.keep("images", &place, posed)? {
            poses.push(names.find(path, written), camera, pose, Vec::new());
        }
    }
    for (id, point) in part.get("points").and_then(Value::as_object).into_iter().flatten() {
        let place = format!("point {id}");
        let position = Json { path, value: point, place: &place }.array::<3>("coordinates");
        if let Some(position) = poses.keep("points", &place, position)? {
            poses.points.push(Point3::from_vector(Vector3::from(position)));
        }
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

fn read_camera(camera: &Json<'_>) -> Result<Intrinsics, MappingError> {
    let model = camera.text("projection_type")?;
    let is_fisheye = match model {
        "perspective" | "simple_radial" | "radial" | "brown" => false,
        "fisheye" | "fisheye_opencv" => true,
        "spherical" | "equirectangular" => {
            return Err(camera.fault("panoramas have no pinhole image"));
        }
        other => {
            return Err(camera.fault(format!(
                "its projection_type is {other:?}; perspective, simple_radial, radial, brown, fisheye and fisheye_opencv \
                 are read"
            )));
        }
    };
    let size = (camera.needed("width")? as u32, camera.needed("height")? as u32);
    let side = f64::from(size.0.max(size.1));
    let or_zero = |key: &str| camera.number(key).map(|number| number.unwrap_or(0.0));
    let fx = match camera.number("focal_x")? {
        Some(focal) => focal,
        None => camera.needed("focal")?,
    };
    let fy = camera.number("focal_y")?.unwrap_or(fx);
    let focal = [fx * side, fy * side];
    let principal =
        [or_zero("c_x")? * side + 0.5 * f64::from(size.0), or_zero("c_y")? * side + 0.5 * f64::from(size.1)];
    let k = [or_zero("k1")?, or_zero("k2")?, or_zero("k3")?, or_zero("k4")?];
    let p = [or_zero("p1")?, or_zero("p2")?, 0.0, 0.0];
    Lens { size, focal, principal, k, p, skew: 0.0, is_fisheye }.intrinsics(camera.path)
}
