//! `transforms.json` of nerfstudio and instant-ngp, and of the many programs that export it.
//!
//! `transform_matrix` is camera to world, 4 × 4 row by row, camera axes right, up, backward (OpenGL). Intrinsics
//! (`fl_x`, `fl_y`, `cx`, `cy`, `w`, `h`, `k1` to `k4`, `p1`, `p2`, `camera_model`) are those of the frame, or else of the
//! document; without a focal length it is that of `camera_angle_x`, and without a size it is that of the image.
//! Pixels count from the corner. `camera_model` is `OPENCV` (the default), `PINHOLE`, `SIMPLE_PINHOLE` or
//! `OPENCV_FISHEYE`.
//!
//! `applied_transform` (3 × 4) and `applied_scale` are what nerfstudio did to the poses of the program before:
//! `x_nerfstudio = scale * transform * x_before`. They are undone, so poses are in the frame of that program.
//!
//! Source: nerfstudio, `docs/quickstart/data_conventions.md`, `nerfstudio/process_data/colmap_utils.py`
//! (`colmap_to_json`) and `nerfstudio/data/dataparsers/nerfstudio_dataparser.py`.

use std::path::Path;

use serde_json::Value;
use veiloc_geometry::nalgebra::{Matrix3, Matrix4};
use veiloc_geometry::{CameraFromWorld, Intrinsics};

use super::cameras::Lens;
use super::json::{Json, document};
use super::names::ImageNames;
use super::posed_input::{Poses, pose_of_opengl};
use crate::error::MappingError;

pub(super) fn read(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let value = document(path)?;
    let shared = Json { path, value: &value, place: "" };
    let frames = value.get("frames").and_then(Value::as_array);
    let frames = frames.ok_or_else(|| shared.fault("frames is missing"))?;
    let before = before_from_world(&shared)?;
    let mut poses = Poses::default();
    for (index, frame) in frames.iter().enumerate() {
        let place = format!("frames[{index}]");
        let frame = Json { path, value: frame, place: &place };
        let Some(written) = poses.keep("frames", &place, frame.text("file_path"))? else { continue };
        let sized = Sized { frame, shared };
        let found = sized.size().and_then(|size| match size {
            Some(size) => Ok(Some((names.find(path, written), size))),
            None => names.with_size(path, written),
        });
        let Some(found) = poses.keep("frames", &place, found)? else { continue };
        let Some((name, size)) = found else {
            poses.without_file.push(written.to_owned());
            continue;
        };
        let posed = sized.camera(size).and_then(|camera| Ok((camera, pose(&frame, &before)?)));
        if let Some((camera, pose)) = poses.keep("frames", &place, posed)? {
            poses.push(name, camera, pose, Vec::new());
        }
    }
    if before.0 != Matrix4::identity() {
        let remark = "applied_transform is undone: poses are in the frame of the program before nerfstudio";
        poses.remarks.push(remark.to_owned());
    }
    Ok(poses)
}

fn pose(frame: &Json<'_>, before: &(Matrix4<f64>, f64)) -> Result<CameraFromWorld, MappingError> {
    let matrix = frame.matrix("transform_matrix")?;
    let matrix = matrix.ok_or_else(|| frame.fault("transform_matrix is missing"))?;
    let (before_from_world, scale) = before;
    let mut before_from_cam = before_from_world * matrix;
    // The inverse of a transform with a scale scales the rotation, too.
    before_from_cam.fixed_view_mut::<3, 3>(0, 0).scale_mut(*scale);
    pose_of_opengl(&before_from_cam)
        .ok_or_else(|| frame.fault("transform_matrix is no rotation and translation"))
}

/// The inverse of what nerfstudio did to the poses, and its scale.
fn before_from_world(document: &Json<'_>) -> Result<(Matrix4<f64>, f64), MappingError> {
    let scale = document.number("applied_scale")?.unwrap_or(1.0);
    let mut world_from_before = document.matrix("applied_transform")?.unwrap_or_else(Matrix4::identity);
    world_from_before.fixed_view_mut::<3, 4>(0, 0).scale_mut(scale);
    let rotation: Matrix3<f64> = world_from_before.fixed_view::<3, 3>(0, 0).into_owned();
    let scale = rotation.determinant().abs().cbrt();
    let inverse = world_from_before.try_inverse().filter(|_| scale > 0.0 && rotation.determinant() > 0.0);
    let inverse = inverse.ok_or_else(|| document.fault("applied_transform is no similarity"))?;
    Ok((inverse, scale))
}

/// Intrinsics of a frame, or else of the document.
struct Sized<'a> {
    frame: Json<'a>,
    shared: Json<'a>,
}

impl Sized<'_> {
    fn number(&self, key: &str) -> Result<Option<f64>, MappingError> {
        Ok(match self.frame.number(key)? {
            Some(number) => Some(number),
            None => self.shared.number(key)?,
        })
    }

    fn size(&self) -> Result<Option<(u32, u32)>, MappingError> {
        let (w, h) = (self.number("w")?, self.number("h")?);
        Ok(w.zip(h).map(|(w, h)| (w as u32, h as u32)))
    }

    fn camera(&self, size: (u32, u32)) -> Result<Intrinsics, MappingError> {
        let (w, h) = (f64::from(size.0), f64::from(size.1));
        let of_angle = |angle: f64, side: f64| 0.5 * side / (0.5 * angle).tan();
        let along = |json: &Json<'_>, focal: &str, angle: &str, side: f64| -> Result<_, MappingError> {
            Ok(match json.number(focal)? {
                Some(focal) => Some(focal),
                None => json.number(angle)?.map(|angle| of_angle(angle, side)),
            })
        };
        // Both focal lengths are of the frame, or both of the document.
        let focal_of = |json: &Json<'_>| -> Result<Option<[f64; 2]>, MappingError> {
            let Some(fx) = along(json, "fl_x", "camera_angle_x", w)? else { return Ok(None) };
            Ok(Some([fx, along(json, "fl_y", "camera_angle_y", h)?.unwrap_or(fx)]))
        };
        let focal = match focal_of(&self.frame)? {
            Some(focal) => focal,
            None => focal_of(&self.shared)?
                .ok_or_else(|| self.frame.fault("fl_x is missing, and so is camera_angle_x"))?,
        };
        let or_zero = |key: &str| self.number(key).map(|number| number.unwrap_or(0.0));
        let principal = [self.number("cx")?.unwrap_or(0.5 * w), self.number("cy")?.unwrap_or(0.5 * h)];
        let k = [or_zero("k1")?, or_zero("k2")?, or_zero("k3")?, or_zero("k4")?];
        let of = |json: &Json<'_>| json.value.get("camera_model").and_then(Value::as_str).map(str::to_owned);
        let model = of(&self.frame).or_else(|| of(&self.shared)).unwrap_or_else(|| "OPENCV".to_owned());
        let is_fisheye = self.shared.value.get("is_fisheye").and_then(Value::as_bool) == Some(true);
        let is_fisheye = match model.as_str() {
            "OPENCV_FISHEYE" => true,
            "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" => is_fisheye,
            "SIMPLE_RADIAL" | "RADIAL" => false,
            other => {
                return Err(self.frame.fault(format!(
                    "camera_model is {other:?}; OPENCV, PINHOLE and OPENCV_FISHEYE are read"
                )));
            }
        };
        let p = [or_zero("p1")?, or_zero("p2")?, 0.0, 0.0];
        Lens { size, focal, principal, k, p, skew: 0.0, is_fisheye }.intrinsics(self.frame.path)
    }
}
