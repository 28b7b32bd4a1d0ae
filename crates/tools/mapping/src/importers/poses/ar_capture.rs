//! Captures of apps that record the poses of ARKit: Polycam (raw data), Record3D, 3D Scanner App.
//!
//! All have camera-to-world poses in ARKit's world: `y` up, metres, camera axes right, up, backward, for the image as the
//! sensor takes it (landscape). Intrinsics are pixels from the corner.
//!
//! | app | file | pose | intrinsics |
//! |---|---|---|---|
//! | Polycam | `keyframes/corrected_cameras/ID.json` or `cameras/ID.json` | `t_00` to `t_23` | `fx, fy, cx, cy, width, height` |
//! | Record3D | `metadata` or `metadata.json` | `poses`: `[qx, qy, qz, qw, x, y, z]` of frame 0, 1, … | `K` column by column, `w`, `h` |
//! | 3D Scanner App | `frame_00000.json` | `cameraPoseARFrame`, row by row | `intrinsics`, row by row |
//!
//! Source: `polycam_utils.py` and `record3d_utils.py` of nerfstudio (`nerfstudio/process_data`), whose permutation of the world
//! axes is not applied here; Apple, *ARCamera* (`transform`, `intrinsics`).

use std::path::{Path, PathBuf};

use veiloc_geometry::nalgebra::Matrix4;

use super::cameras::Brown;
use super::json::{Json, document};
use super::names::{ImageNames, without_extension};
use super::posed_input::{Poses, down, faulty, pose_of_opengl};
use super::times::Stamped;
use crate::error::MappingError;

/// An empty result in ARKit's world.
fn arkit() -> Poses {
    Poses { down: down(0.0, -1.0, 0.0), ..Poses::default() }
}

/// A folder of one JSON file for each image.
pub(super) fn read_polycam(folder: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let mut poses = arkit();
    for path in json_files(folder) {
        let value = document(&path)?;
        let frame = Json { path: &path, value: &value, place: "" };
        let mut matrix = Matrix4::identity();
        for row in 0..3 {
            for column in 0..4 {
                matrix[(row, column)] = frame.needed(&format!("t_{row}{column}"))?;
            }
        }
        let pose = pose_of_opengl(&matrix)
            .ok_or_else(|| frame.fault("t_00 to t_23 are no rotation and translation"))?;
        let size = (frame.needed("width")? as u32, frame.needed("height")? as u32);
        let camera = Brown {
            size,
            focal: [frame.needed("fx")?, frame.needed("fy")?],
            principal: [frame.needed("cx")?, frame.needed("cy")?],
            ..Brown::default()
        };
        poses.push(names.find(&path, &stem(&path)), camera.intrinsics(&path)?, pose, Vec::new());
    }
    Ok(poses)
}

/// A folder of one `frame_00000.json` for each image; frames without an image file were not stored by the app.
pub(super) fn read_scanner_app(folder: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let mut poses = arkit();
    let mut not_stored = 0;
    for path in json_files(folder).into_iter().filter(|path| stem(path).starts_with("frame_")) {
        let Some((name, size)) = names.with_size(&path, &stem(&path))? else {
            not_stored += 1;
            continue;
        };
        let value = document(&path)?;
        let frame = Json { path: &path, value: &value, place: "" };
        let matrix =
            frame.matrix("cameraPoseARFrame")?.ok_or_else(|| frame.fault("cameraPoseARFrame is missing"))?;
        let pose = pose_of_opengl(&matrix);
        let pose = pose.ok_or_else(|| frame.fault("cameraPoseARFrame is no rotation and translation"))?;
        let [fx, _, cx, _, fy, cy, _, _, _] = frame.array::<9>("intrinsics")?;
        let camera = Brown { size, focal: [fx, fy], principal: [cx, cy], ..Brown::default() };
        poses.push(name, camera.intrinsics(&path)?, pose, Vec::new());
    }
    if not_stored > 0 {
        poses.remarks.push(format!("{not_stored} poses without an image file are left out"));
    }
    Ok(poses)
}

/// `metadata` of Record3D; images are named by their frame number, from 0.
pub(super) fn read_record3d(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let value = document(path)?;
    let all = Json { path, value: &value, place: "" };
    let k = all.array::<9>("K")?;
    let size = (all.needed("w")? as u32, all.needed("h")? as u32);
    // Column by column.
    let [fx, _, _, _, fy, _, cx, cy, _] = k;
    let camera = Brown { size, focal: [fx, fy], principal: [cx, cy], ..Brown::default() }.intrinsics(path)?;
    let listed = value.get("poses").and_then(serde_json::Value::as_array);
    let listed = listed.ok_or_else(|| all.fault("poses is missing"))?;
    let mut poses = arkit();
    let mut others = 0;
    for name in names.all() {
        let file = name.rsplit('/').next().unwrap_or_default();
        let Some((index, pose)) =
            without_extension(file).parse::<usize>().ok().and_then(|i| Some((i, listed.get(i)?)))
        else {
            others += 1;
            continue;
        };
        let place = format!("poses[{index}]");
        let fault = || faulty(path, format!("{place}: is no qx, qy, qz, qw, x, y, z"));
        let numbers: Vec<f64> =
            pose.as_array().into_iter().flatten().filter_map(serde_json::Value::as_f64).collect();
        let [qx, qy, qz, qw, x, y, z] = numbers[..] else { return Err(fault()) };
        let body = Stamped::new(0.0, [qw, qx, qy, qz], [x, y, z]).ok_or_else(fault)?;
        let mut matrix = body.rotation.to_homogeneous();
        matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&body.position);
        let pose = pose_of_opengl(&matrix).ok_or_else(fault)?;
        poses.push(name, camera, pose, Vec::new());
    }
    if others > 0 {
        poses.remarks.push(format!("{others} images are left out: their names are no numbers of a pose"));
    }
    Ok(poses)
}

fn stem(path: &Path) -> String {
    path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The JSON files of a folder, sorted.
pub(super) fn json_files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> =
        entries.filter(|path| path.extension().is_some_and(|e| e == "json")).collect();
    files.sort();
    files
}
