//! Writes COLMAP's text files.

use std::fmt::Write as _;
use std::path::Path;

use veiloc_geometry::frames::Rigid3;

use super::folder::write_files;
use super::model::ColmapModel;
use super::rigs::{ColmapFrame, ColmapRig};
use crate::error::MapError;

/// Writes a model as `cameras.txt`, `images.txt`, `points3D.txt`, `rigs.txt` and `frames.txt` into a folder, which is
/// created if missing; each file is replaced atomically.
///
/// Numbers are printed with enough digits to be read back exactly.
///
/// # Errors
/// [`MapError::BinaryModelThere`]: the folder holds a binary model, which readers would prefer; [`MapError::Io`].
pub fn write_text(model: &ColmapModel, dir: &Path) -> Result<(), MapError> {
    check_text_folder(dir)?;
    let written = model.rigs_to_write();
    let files = [
        ("rigs.txt", rigs(&written.rigs)),
        ("frames.txt", frames(&written.frames)),
        ("cameras.txt", cameras(model)),
        ("images.txt", images(model)),
        ("points3D.txt", points(model)),
    ];
    write_files(dir, files.map(|(name, content)| (name, content.into_bytes())))
}

/// Checks that a folder has no binary model, which readers would prefer to the text.
///
/// # Errors
/// [`MapError::BinaryModelThere`].
pub fn check_text_folder(dir: &Path) -> Result<(), MapError> {
    let binary = ["cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin"];
    if binary.iter().any(|name| dir.join(name).exists()) {
        return Err(MapError::BinaryModelThere { dir: dir.to_owned() });
    }
    Ok(())
}

/// Formats into a string, which cannot fail.
macro_rules! put {
    ($out:expr, $($part:tt)*) => { write!($out, $($part)*).expect("a string takes all that is written to it") };
}

fn rigs(rigs: &[ColmapRig]) -> String {
    let mut out = String::from(
        "# RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as (SENSOR_TYPE, SENSOR_ID, HAS_POSE, [QW, QX, QY, \
         QZ, TX, TY, TZ])\n",
    );
    for rig in rigs {
        put!(out, "{} {}", rig.id, usize::from(rig.reference.is_some()) + rig.sensors.len());
        if let Some(sensor) = rig.reference {
            put!(out, " {} {}", sensor.kind.name(), sensor.id);
        }
        for (sensor, pose) in &rig.sensors {
            put!(out, " {} {} {}", sensor.kind.name(), sensor.id, u8::from(pose.is_some()));
            if let Some(pose) = pose {
                put_pose(&mut out, pose);
            }
        }
        out.push('\n');
    }
    out
}

fn frames(frames: &[ColmapFrame]) -> String {
    let mut out = String::from(
        "# FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], NUM_DATA_IDS, DATA_IDS[] as (SENSOR_TYPE, SENSOR_ID, \
         DATA_ID)\n",
    );
    for frame in frames {
        put!(out, "{} {}", frame.id, frame.rig_id);
        put_pose(&mut out, &frame.rig_from_world);
        put!(out, " {}", frame.data.len());
        for (sensor, data) in &frame.data {
            put!(out, " {} {} {data}", sensor.kind.name(), sensor.id);
        }
        out.push('\n');
    }
    out
}

/// ` QW QX QY QZ TX TY TZ`
fn put_pose<Out, In>(out: &mut String, pose: &Rigid3<Out, In>) {
    for value in pose.quaternion().iter().chain(pose.translation().iter()) {
        put!(out, " {value}");
    }
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
        put_pose(&mut out, &image.cam_from_world);
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
