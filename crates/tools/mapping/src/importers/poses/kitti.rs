//! Poses of KITTI's odometry benchmark: 12 numbers a line, the rows of `[R | t]` of the left gray camera (`image_0`) to the
//! world, one line a frame; camera axes right, down, forward.
//!
//! `calib.txt` has the projection `P0` to `P3` of each rectified camera; it is searched beside the poses, in the folder of the
//! images and in that above it. The camera is that of the folder's name, `image_0` to `image_3`, or the only one; its centre is
//! `−K⁻¹ P[:, 3]` from that of `image_0`. Frames are named by their number, from 0. Pixels count from the centre of the first
//! one, so half a pixel is added.
//!
//! Source: A. Geiger, KITTI odometry development kit, `readme.txt` ("Data Format Description").

use std::path::Path;

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix3, Matrix4, Vector3};

use super::cameras::Lens;
use super::names::{ImageNames, without_extension};
use super::posed_input::{Poses, faulty, pose_of_world_from_cam, text};
use super::times::{LOST, lost};
use crate::error::MappingError;
use crate::importers::lines::Line;

pub(super) fn read(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let content = text(path)?;
    let mut poses = Poses::default();
    // Images are named by the number of the line, also after one that is odd.
    let mut frames = Vec::new();
    for line in Line::all(path, &content).filter(|line| !line.words[0].starts_with('#')) {
        // A line that has no numbers is perhaps no pose: then the others have other numbers.
        for at in 0..12 {
            line.number::<f64>(at, "a pose")?;
        }
        let pose = line.numbers::<12>(0, "a pose").and_then(|rows| {
            let mut matrix = Matrix4::identity();
            matrix.fixed_view_mut::<3, 4>(0, 0).copy_from_slice(&transposed(rows));
            let pose = pose_of_world_from_cam(&matrix);
            let pose = pose.ok_or_else(|| line.fault("the pose is no rotation and translation"))?;
            Ok((pose, matrix == Matrix4::identity()))
        });
        frames.push(poses.keep("poses", &line.place(), pose)?);
    }
    let is_identity: Vec<bool> =
        frames.iter().map(|frame| frame.is_some_and(|(_, is_identity)| is_identity)).collect();
    let lost = lost(&is_identity);
    for (index, frame) in frames.iter_mut().enumerate().filter(|(index, _)| lost[*index]) {
        poses.leave_out("poses", &format!("that of frame {index}"), LOST);
        *frame = None;
    }
    let folder = names.folder();
    let folder_name = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let folder_name =
        folder_name.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let number = folder_name.strip_prefix("image_").and_then(|n| n.parse::<u32>().ok());
    let (intrinsics, cam_from_left) = calibration(path, names, number)?;
    for name in names.all() {
        let stem = without_extension(name.rsplit('/').next().unwrap_or_default());
        let frame = stem.parse::<usize>().ok().and_then(|index| frames.get(index));
        let Some(frame) = frame else {
            poses.leave_out("images", &name, "their names are no numbers of a pose");
            continue;
        };
        let Some((frame, _)) = frame else {
            poses.leave_out("images", &name, "their poses are left out");
            continue;
        };
        let Some(found) = poses.keep("images", &name, names.with_size(path, &name))? else { continue };
        let Some((name, size)) = found else { continue };
        let [fx, fy, cx, cy, skew] = intrinsics;
        let lens = Lens { size, focal: [fx, fy], principal: [cx + 0.5, cy + 0.5], skew, ..Lens::default() };
        let pose = CameraFromWorld::new(*frame.rotation(), frame.translation() + cam_from_left);
        poses.push(name, lens.intrinsics(path)?, pose, Vec::new());
    }
    Ok(poses)
}

/// Whether a word is `P0:` to `P3:`.
fn is_projection(word: &str) -> bool {
    word.strip_prefix('P').and_then(|rest| rest.strip_suffix(':')).is_some_and(|n| n.parse::<u8>().is_ok())
}

/// Column-major numbers of a 3 × 4 matrix of row-major ones.
fn transposed(rows: [f64; 12]) -> [f64; 12] {
    std::array::from_fn(|at| rows[4 * (at % 3) + at / 3])
}

/// `fx, fy, cx, cy, skew` of a camera, and its translation from `image_0`. `number`: that of the folder; without one all cameras of the
/// file must be the same.
fn calibration(
    path: &Path,
    names: &ImageNames,
    number: Option<u32>,
) -> Result<([f64; 5], Vector3<f64>), MappingError> {
    let folder = names.folder();
    let candidates = [
        path.with_file_name("calib.txt"),
        folder.join("calib.txt"),
        folder.parent().unwrap_or(folder).join("calib.txt"),
    ];
    let file = candidates.iter().find(|file| file.is_file()).ok_or_else(|| {
        faulty(path, "there is no calib.txt beside it, in the folder of the images, or above that folder")
    })?;
    let content = text(file)?;
    let key = number.map(|number| format!("P{number}:"));
    let is_camera = |word: &str| key.as_ref().map_or_else(|| is_projection(word), |key| word == key);
    let cameras: Vec<Line<'_>> = Line::all(file, &content).filter(|line| is_camera(line.words[0])).collect();
    let line = cameras.first();
    let line = line.ok_or_else(|| faulty(file, format!("has no {}", key.as_deref().unwrap_or("P0:"))))?;
    if key.is_none() && cameras.iter().any(|other| other.words[1..] != line.words[1..]) {
        return Err(faulty(
            file,
            "has several cameras, and the name of the folder of the images says which of them took them: call it image_0 to image_3",
        ));
    }
    let [fx, skew, cx, tx, zero, fy, cy, ty, _, _, _, tz] =
        line.numbers::<12>(1, "a number of the projection")?;
    let k = Matrix3::new(fx, skew, cx, zero, fy, cy, 0.0, 0.0, 1.0);
    let inverse = k.try_inverse().filter(|_| zero == 0.0);
    let inverse = inverse.ok_or_else(|| line.fault("is not the projection of a camera"))?;
    Ok(([fx, fy, cx, cy, skew], inverse * Vector3::new(tx, ty, tz)))
}
