//! Writes COLMAP's binary files: a count, then little-endian records.

use std::path::Path;

use super::binary::NO_POINT;
use super::folder::write_files;
use super::model::{ColmapImage, ColmapModel, ColmapPoint};
use crate::error::MapError;
use veiloc_geometry::Intrinsics;

/// Writes a model as `cameras.bin`, `images.bin` and `points3D.bin` into a folder, which is created if missing; each
/// file is replaced atomically.
///
/// # Errors
/// [`MapError::Io`] naming the file.
pub fn write_binary(model: &ColmapModel, dir: &Path) -> Result<(), MapError> {
    let cameras = records(model.cameras(), |(id, camera), out| put_camera(*id, camera, out));
    let files = [
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
    put_f64s(&image.cam_from_world.quaternion(), out);
    put_f64s(image.cam_from_world.translation(), out);
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
