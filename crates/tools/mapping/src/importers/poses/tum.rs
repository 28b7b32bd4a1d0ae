//! A trajectory in the form of TUM's RGB-D benchmark, which many SLAM programs write:
//! `time tx ty tz qx qy qz qw`, camera to world, seconds, `#` comments; camera axes right, down, forward.
//!
//! The camera is the only one of `cameras.txt` (COLMAP's text) beside the trajectory. The time of an image is that of the
//! list `rgb.txt` beside the trajectory (`time path`) if there is one, or else that of its name. Poses are interpolated
//! between two that are at most 0.2 s apart; without those, the nearest counts within 0.02 s.
//!
//! Source: TUM Computer Vision Group, *RGB-D SLAM Dataset and Benchmark*, "File Formats", and its `associate.py`.

use std::path::Path;

use veiloc_geometry::Intrinsics;

use super::names::ImageNames;
use super::posed_input::{Poses, faulty, text};
use super::times::{Stamped, pose_at_time, time_of};
use crate::error::MappingError;
use crate::importers::lines::Line;

pub(super) fn read(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let content = text(path)?;
    let mut trajectory = Vec::new();
    for line in Line::all(path, &content).filter(|line| !line.words[0].starts_with('#')) {
        let [time, x, y, z, qx, qy, qz, qw] = line.numbers(0, "a pose")?;
        let pose = Stamped::new(time, [qw, qx, qy, qz], [x, y, z]);
        trajectory.push(pose.ok_or_else(|| line.fault("the quaternion is not a rotation"))?);
    }
    trajectory.sort_by(|a, b| a.time.total_cmp(&b.time));
    let camera = only_camera(path)?;
    let images = timed_images(path, &path.with_file_name("rgb.txt"), names)?;
    let mut poses = Poses::default();
    let mut without_pose = 0;
    for (time, name) in images {
        match pose_at_time(&trajectory, time) {
            Some(pose) => poses.push(name, camera, pose.cam_from_world(), Vec::new()),
            None => without_pose += 1,
        }
    }
    if without_pose > 0 {
        poses
            .remarks
            .push(format!("{without_pose} images are left out: the trajectory has no pose near their times"));
    }
    Ok(poses)
}

/// The images of a list with times, or the images of the folder with the times of their names, sorted by time.
fn timed_images(path: &Path, list: &Path, names: &ImageNames) -> Result<Vec<(f64, String)>, MappingError> {
    let mut images = Vec::new();
    if list.is_file() {
        let content = text(list)?;
        for line in Line::all(list, &content).filter(|line| !line.words[0].starts_with('#')) {
            let [time] = line.numbers(0, "the time")?;
            images.push((time, names.find(list, &line.words[1..].join(" "))));
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
