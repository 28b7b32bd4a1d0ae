//! Writes COLMAP's binary files: a count, then little-endian records.

use std::path::Path;

use super::binary::NO_POINT;
use super::folder::write_files;
use super::model::ColmapModel;
use super::records::{ColmapImage, ColmapPoint};
use super::rigs::{ColmapFrame, ColmapRig, ColmapSensor};
use crate::error::MapError;
use veiloc_geometry::Intrinsics;
use veiloc_geometry::frames::Rigid3;

/// Writes a model as `cameras.bin`, `images.bin`, `points3D.bin`, `rigs.bin` and `frames.bin` into a folder, which is
/// created if missing; each file is replaced atomically.
///
/// # Errors
/// [`MapError::Io`] naming the file.
pub fn write_binary(model: &ColmapModel, dir: &Path) -> Result<(), MapError> {
    let cameras = records(model.cameras(), |(id, camera), out| put_camera(*id, camera, out));
    let written = model.rigs_to_write();
    let files = [
        ("rigs.bin", records(&written.rigs, put_rig)),
        ("frames.bin", records(&written.frames, put_frame)),
        ("cameras.bin", cameras),
        ("images.bin", records(model.images(), put_image)),
        ("points3D.bin", records(model.points(), put_point)),
    ];
    write_files(dir, files)
}

/// A count, and each record.
fn records<T>(
    all: impl IntoIterator<Item = T, IntoIter: ExactSizeIterator>,
    put: impl Fn(T, &mut Vec<u8>),
) -> Vec<u8> {
    let all = all.into_iter();
    let mut out = (all.len() as u64).to_le_bytes().to_vec();
    all.for_each(|one| put(one, &mut out));
    out
}

fn put_f64s<'a>(values: impl IntoIterator<Item = &'a f64>, out: &mut Vec<u8>) {
    out.extend(values.into_iter().flat_map(|value| value.to_le_bytes()));
}

fn put_sensor(sensor: ColmapSensor, out: &mut Vec<u8>) {
    out.extend(sensor.kind.number().to_le_bytes());
    out.extend(sensor.id.to_le_bytes());
}

fn put_pose<Out, In>(pose: &Rigid3<Out, In>, out: &mut Vec<u8>) {
    put_f64s(&pose.quaternion(), out);
    put_f64s(pose.translation(), out);
}

/// As `rig` in `binary.rs` reads it.
fn put_rig(rig: &ColmapRig, out: &mut Vec<u8>) {
    out.extend(rig.id.to_le_bytes());
    let count = u32::from(rig.reference.is_some()) + rig.sensors.len() as u32;
    out.extend(count.to_le_bytes());
    if let Some(sensor) = rig.reference {
        put_sensor(sensor, out);
    }
    for (sensor, pose) in &rig.sensors {
        put_sensor(*sensor, out);
        out.push(u8::from(pose.is_some()));
        if let Some(pose) = pose {
            put_pose(pose, out);
        }
    }
}

/// As `frame` in `binary.rs` reads it.
fn put_frame(frame: &ColmapFrame, out: &mut Vec<u8>) {
    out.extend(frame.id.to_le_bytes());
    out.extend(frame.rig_id.to_le_bytes());
    put_pose(&frame.rig_from_world, out);
    out.extend((frame.data.len() as u32).to_le_bytes());
    for (sensor, data) in &frame.data {
        put_sensor(*sensor, out);
        out.extend(data.to_le_bytes());
    }
}

/// `id: u32, model: i32, width: u64, height: u64, params: f64[]`
fn put_camera(id: u32, camera: &Intrinsics, out: &mut Vec<u8>) {
    out.extend(id.to_le_bytes());
    out.extend(camera.model.colmap_id().to_le_bytes());
    out.extend(u64::from(camera.width).to_le_bytes());
    out.extend(u64::from(camera.height).to_le_bytes());
    put_f64s(camera.model.params(), out);
}

/// `id: u32, q: f64[4], t: f64[3], camera: u32, name: bytes to 0, points: u64, (x: f64, y: f64, point: u64)[]`
fn put_image(image: &ColmapImage, out: &mut Vec<u8>) {
    out.extend(image.id.to_le_bytes());
    put_pose(&image.cam_from_world, out);
    out.extend(image.camera_id.to_le_bytes());
    out.extend(image.name.as_bytes());
    out.push(0);
    out.extend((image.points2d.len() as u64).to_le_bytes());
    for p in &image.points2d {
        put_f64s(&[p.pixel.u, p.pixel.v], out);
        out.extend(p.point.unwrap_or(NO_POINT).to_le_bytes());
    }
}

/// `id: u64, xyz: f64[3], rgb: u8[3], error: f64, track: u64, (image: u32, keypoint: u32)[]`
fn put_point(point: &ColmapPoint, out: &mut Vec<u8>) {
    out.extend(point.id.to_le_bytes());
    put_f64s(&point.position.coords, out);
    out.extend(point.color);
    put_f64s(&[point.error], out);
    out.extend((point.track.len() as u64).to_le_bytes());
    for (image, keypoint) in &point.track {
        out.extend(image.to_le_bytes());
        out.extend(keypoint.to_le_bytes());
    }
}
