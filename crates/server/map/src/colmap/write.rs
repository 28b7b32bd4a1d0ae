//! Writes COLMAP's text files.

use std::fmt::Write as _;
use std::path::Path;

use super::folder::write_files;
use super::model::ColmapModel;
use crate::error::MapError;

/// Writes a model as `cameras.txt`, `images.txt` and `points3D.txt` into a folder, which is created if missing; each
/// file is replaced atomically.
///
/// Numbers are printed with enough digits to be read back exactly.
///
/// # Errors
/// [`MapError::BinaryModelThere`]: the folder holds a binary model, which readers would prefer; [`MapError::Io`].
pub fn write_text(model: &ColmapModel, dir: &Path) -> Result<(), MapError> {
    if ["cameras.bin", "images.bin", "points3D.bin"].iter().any(|name| dir.join(name).exists()) {
        return Err(MapError::BinaryModelThere { dir: dir.to_owned() });
    }
    let files =
        [("cameras.txt", cameras(model)), ("images.txt", images(model)), ("points3D.txt", points(model))];
    write_files(dir, files.map(|(name, content)| (name, content.into_bytes())))
}

/// Formats into a string, which cannot fail.
macro_rules! put {
    ($out:expr, $($part:tt)*) => { write!($out, $($part)*).expect("a string takes all that is written to it") };
}

fn cameras(model: &ColmapModel) -> String {
    let mut out = String::from("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n");
    for (id, camera) in model.cameras() {
        put!(out, "{id} {} {} {}", camera.model.name(), camera.width, camera.height);
        for value in camera.model.params() {
            put!(out, " {value}");
        }
        out.push('\n');
    }
    out
}

fn images(model: &ColmapModel) -> String {
    let mut out = String::from(
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n",
    );
    for image in model.images() {
        put!(out, "{}", image.id);
        for value in image.cam_from_world.quaternion().iter().chain(image.cam_from_world.translation().iter())
        {
            put!(out, " {value}");
        }
        put!(out, " {} {}\n", image.camera_id, image.name);
        for (i, p) in image.points2d.iter().enumerate() {
            let separator = if i == 0 { "" } else { " " };
            let point = p.point.map_or(-1, |id| id as i64);
            put!(out, "{separator}{} {} {point}", p.pixel.u, p.pixel.v);
        }
        out.push('\n');
    }
    out
}

fn points(model: &ColmapModel) -> String {
    let mut out = String::from("# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n");
    for point in model.points() {
        let (x, [r, g, b]) = (point.position.coords, point.color);
        put!(out, "{} {} {} {} {r} {g} {b} {}", point.id, x.x, x.y, x.z, point.error);
        for (image, keypoint) in &point.track {
            put!(out, " {image} {keypoint}");
        }
        out.push('\n');
    }
    out
}
