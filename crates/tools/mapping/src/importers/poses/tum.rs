//! A trajectory in the form of TUM's RGB-D benchmark, which many SLAM programs write:
//! `time tx ty tz qx qy qz qw`, camera to world, seconds, `#` comments; camera axes right, down, forward.
//!
//! The camera is the only one of `cameras.txt` (COLMAP's text) beside the trajectory. The time of an image is that of the
//! list `rgb.txt` beside the trajectory (`time path`) if there is one, or else that of its name. Poses are interpolated
//! between two that are at most 0.2 s apart; without those, the nearest counts within 0.02 s. Times of 13 digits and more are
//! milliseconds, microseconds or nanoseconds. If a comment says `qw qx qy qz`, that is the order.
//!
//! Source: TUM Computer Vision Group, *RGB-D SLAM Dataset and Benchmark*, "File Formats", and its `associate.py`.

use std::path::Path;

use veiloc_geometry::Intrinsics;

use super::names::ImageNames;
use super::posed_input::{Poses, faulty, text};
use super::times::{Stamped, pose_images, seconds_of, time_of, tracked};
use crate::error::MappingError;
use crate::importers::lines::Line;

pub(super) fn read(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let content = text(path)?;
    let mut poses = Poses::default();
    let is_w_first = content.lines().take(8).any(|line| line.to_lowercase().contains("qw qx qy qz"));
    if is_w_first {
        poses.remarks.push("quaternions are read as qw qx qy qz, as the head of the file says".to_owned());
    }
    let mut trajectory = Vec::new();
    for line in Line::all(path, &content).filter(|line| !line.words[0].starts_with('#')) {
        let pose = line.numbers(0, "a pose").and_then(|[time, x, y, z, a, b, c, d]| {
            let wxyz = if is_w_first { [a, b, c, d] } else { [d, a, b, c] };
            let pose = Stamped::new(seconds_of(time), wxyz, [x, y, z]);
            pose.ok_or_else(|| line.fault("the quaternion is not a rotation"))
        });
        trajectory.extend(poses.keep("poses", &line.place(), pose)?);
    }
    let trajectory = tracked(trajectory, &mut poses);
    let camera = only_camera(path)?;
    let images = timed_images(path, &path.with_file_name("rgb.txt"), names, &mut poses)?;
    pose_images(&mut poses, &trajectory, &images, camera, Stamped::cam_from_world);
    Ok(poses)
}

/// The images of a list with times, or the images of the folder with the times of their names, sorted by time.
fn timed_images(
    path: &Path,
    list: &Path,
    names: &ImageNames,
    poses: &mut Poses,
) -> Result<Vec<(f64, String)>, MappingError> {
    let mut images = Vec::new();
    if list.is_file() {
        let content = text(list)?;
        for line in Line::all(list, &content).filter(|line| !line.words[0].starts_with('#')) {
            if let Some([time]) = poses.keep("images", &line.place(), line.numbers(0, "the time"))? {
                images.push((seconds_of(time), names.find(list, &line.words[1..].join(" "))));
            }
        }
    } else {
        let all = names.all();
        images.extend(all.iter().filter_map(|name| Some((time_of(name)?, name.clone()))));
        if images.is_empty() {
            let reason = format!(
                "no image in {} is called by its time, and there is no list rgb.txt beside the trajectory",
                names.folder().display()
            );
            return Err(faulty(path, reason));
        }
    }
    images.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(images)
}

/// The only camera of `cameras.txt` beside the file.
fn only_camera(path: &Path) -> Result<Intrinsics, MappingError> {
    let file = path.with_file_name("cameras.txt");
    if !file.is_file() {
        let reason = "a trajectory has no camera: write cameras.txt beside it, with one line as COLMAP's (1 PINHOLE \
                      640 480 525 525 320 240)";
        return Err(faulty(path, reason));
    }
    let content = text(&file)?;
    let lines: Vec<Line<'_>> =
        Line::all(&file, &content).filter(|line| !line.words[0].starts_with('#')).collect();
    let [line] = &lines[..] else {
        return Err(faulty(&file, format!("has {} cameras, and a trajectory is of one", lines.len())));
    };
    let params = (4..line.words.len()).map(|at| line.number(at, "a parameter of the camera"));
    let params: Vec<f64> = params.collect::<Result<_, _>>()?;
    let model = line.words.get(1).copied().unwrap_or_default();
    let (w, h) = (line.number(2, "the width")?, line.number(3, "the height")?);
    Intrinsics::new(model, w, h, &params).map_err(|e| line.fault(e.to_string()))
}
