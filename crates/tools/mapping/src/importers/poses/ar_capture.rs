//! Captures of apps that record the poses of ARKit: Polycam (raw data), Record3D, 3D Scanner App.
//!
//! All have camera-to-world poses in ARKit's world: `y` up, metres, camera axes right, up, backward, for the image as the
//! sensor takes it (landscape). Intrinsics are pixels from the corner.
//!
//! | app | file | pose | intrinsics |
//! |---|---|---|---|
//! | Polycam | `keyframes/corrected_cameras/ID.json` or `cameras/ID.json` | `t_00` to `t_23` | `fx, fy, cx, cy, width, height` |
//! | Record3D | `metadata` or `metadata.json` | `poses`: `[qx, qy, qz, qw, x, y, z]` of frame 0, 1, … | `perFrameIntrinsicCoeffs`: `[fx, fy, cx, cy]`, or `K` column by column; `w`, `h` |
//! | 3D Scanner App | `frame_00000.json` | `cameraPoseARFrame`, row by row | `intrinsics`, row by row |
//!
//! Source: `polycam_utils.py` and `record3d_utils.py` of nerfstudio (`nerfstudio/process_data`), whose permutation of the world
//! axes is not applied here; Apple, *ARCamera* (`transform`, `intrinsics`).

use std::path::{Path, PathBuf};

use veiloc_geometry::nalgebra::Matrix4;
use veiloc_map::PosedImage;

use super::cameras::Lens;
use super::json::{Json, document};
use super::names::{ImageNames, without_extension};
use super::posed_input::{Poses, down, faulty, pose_of_opengl};
use super::times::{LOST, Stamped, lost};
use crate::error::MappingError;
use crate::input::image_names::image_file;

/// An empty result in ARKit's world.
fn arkit() -> Poses {
    Poses { down: down(0.0, -1.0, 0.0), ..Poses::default() }
}

/// The poses without those of lost tracking; images are in the order of time.
fn tracked(mut poses: Poses) -> Poses {
    let identity = pose_of_opengl(&Matrix4::identity());
    let is_identity = |image: &PosedImage| Some(image.cam_from_world) == identity;
    let lost = lost(&poses.images.iter().map(is_identity).collect::<Vec<_>>());
    for (image, lost) in std::mem::take(&mut poses.images).into_iter().zip(lost) {
        if lost {
            poses.leave_out("images", &image.name, LOST);
        } else {
            poses.images.push(image);
        }
    }
    poses
}

/// Folders of Polycam: of cameras, and of their images.
const OF_POLYCAM: [(&str, &str); 2] = [("corrected_cameras", "corrected_images"), ("cameras", "images")];

/// A folder of one JSON file for each image.
pub(super) fn read_polycam(folder: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let mut poses = arkit();
    let folder = match cameras_of_images(folder, names)? {
        None => folder.to_owned(),
        Some(other) => {
            let name = other.file_name().unwrap_or_default().display();
            let remark = format!("the folder {name} beside it is read: it has the cameras of these images");
            poses.remarks.push(remark);
            other
        }
    };
    let mut centered = 0;
    for path in json_files(&folder) {
        let stem = stem(&path);
        let Some(value) = poses.keep("images", &stem, document(&path))? else { continue };
        let frame = Json { path: &path, value: &value, place: "" };
        let found = polycam_size(&frame).and_then(|size| match size {
            Some(size) => Ok(Some((names.find(&path, &stem), size))),
            None => names.with_size(&path, &stem),
        });
        let Some(found) = poses.keep("images", &stem, found)? else { continue };
        let Some((name, size)) = found else {
            poses.without_file.push(stem);
            continue;
        };
        let posed = polycam_camera(&frame, size).and_then(|lens| {
            let mut matrix = Matrix4::identity();
            for row in 0..3 {
                for column in 0..4 {
                    matrix[(row, column)] = frame.needed(&format!("t_{row}{column}"))?;
                }
            }
            let pose = pose_of_opengl(&matrix);
            let pose = pose.ok_or_else(|| frame.fault("t_00 to t_23 are no rotation and translation"))?;
            Ok((lens.intrinsics(&path)?, pose))
        });
        if let Some((camera, pose)) = poses.keep("images", &stem, posed)? {
            centered += usize::from(frame.number("cx")?.is_none() || frame.number("cy")?.is_none());
            poses.push(name, camera, pose, Vec::new());
        }
    }
    if centered > 0 {
        poses.remarks.push(format!(
            "{centered} cameras have no principal point (cx, cy); the middle of the image is taken, which may be some \
             pixels off"
        ));
    }
    Ok(tracked(poses))
}

/// The folder of cameras beside this one, if it and not this one is that of the images: by the name of their folder, or by
/// their size.
///
/// # Errors
/// The images are those of the other folder, which is missing.
fn cameras_of_images(folder: &Path, names: &ImageNames) -> Result<Option<PathBuf>, MappingError> {
    let own = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let is_own = |(cameras, _): &(&str, &str)| own.file_name().is_some_and(|own| own == *cameras);
    let Some(at) = OF_POLYCAM.iter().position(is_own) else { return Ok(None) };
    let ((_, images), (other_cameras, other_images)) = (OF_POLYCAM[at], OF_POLYCAM[1 - at]);
    let other = own.with_file_name(other_cameras);
    for path in json_files(folder) {
        let Ok(Some((name, size))) = names.with_size(&path, &stem(&path)) else { continue };
        let image = image_file(names.folder(), &name);
        let image = image.canonicalize().unwrap_or(image);
        // The name of a folder elsewhere means nothing.
        let is_in = |folder: &str| image.parent().is_some_and(|parent| *parent == own.with_file_name(folder));
        let size_in = |path: &Path| {
            let value = document(path).ok()?;
            polycam_size(&Json { path, value: &value, place: "" }).ok()?
        };
        let beside = other.join(path.file_name().unwrap_or_default());
        let is_size_of_other =
            || size_in(&path).is_some_and(|own| own != size) && size_in(&beside) == Some(size);
        if !is_in(other_images) && (is_in(images) || !is_size_of_other()) {
            return Ok(None);
        }
        if json_files(&other).is_empty() {
            let reason = format!(
                "has the cameras of the folder {images}, and the images are those of {other_images}; give the folder \
                 {images} as that of the images"
            );
            return Err(faulty(folder, reason));
        }
        return Ok(Some(folder.with_file_name(other_cameras)));
    }
    Ok(None)
}

/// The size that the app wrote; those of 2025 leave it out.
fn polycam_size(frame: &Json<'_>) -> Result<Option<(u32, u32)>, MappingError> {
    let (width, height) = (frame.number("width")?, frame.number("height")?);
    Ok(width.zip(height).map(|(width, height)| (width as u32, height as u32)))
}

/// A focal length that is missing is that of the same image in `cameras`, a principal point the middle of the image.
fn polycam_camera(frame: &Json<'_>, size: (u32, u32)) -> Result<Lens, MappingError> {
    let focal_of = |frame: &Json<'_>| -> Result<Option<[f64; 2]>, MappingError> {
        let fx = frame.number("fx")?;
        let fy = frame.number("fy")?.or(fx);
        Ok(fx.zip(fy).map(<[f64; 2]>::from))
    };
    let mut focal = focal_of(frame)?;
    let folder = frame.path.parent().unwrap_or(Path::new("")).with_file_name("cameras");
    let path = folder.join(frame.path.file_name().unwrap_or_default());
    if focal.is_none() && path.is_file() {
        focal = focal_of(&Json { path: &path, value: &document(&path)?, place: "" })?;
    }
    let focal = focal.ok_or_else(|| frame.fault("fx is missing, here and in the folder cameras"))?;
    let middle = [0.5 * f64::from(size.0), 0.5 * f64::from(size.1)];
    let principal = [frame.number("cx")?.unwrap_or(middle[0]), frame.number("cy")?.unwrap_or(middle[1])];
    Ok(Lens { size, focal, principal, ..Lens::default() })
}

/// A folder of one `frame_00000.json` for each image; frames without an image file were not stored by the app.
pub(super) fn read_scanner_app(folder: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let mut poses = arkit();
    for path in json_files(folder).into_iter().filter(|path| stem(path).starts_with("frame_")) {
        let stem = stem(&path);
        let Some(found) = poses.keep("images", &stem, names.with_size(&path, &stem))? else { continue };
        let Some((name, size)) = found else {
            poses.leave_out("poses", &stem, "they have no image file");
            continue;
        };
        let posed = document(&path).and_then(|value| {
            let frame = Json { path: &path, value: &value, place: "" };
            let matrix = frame.matrix("cameraPoseARFrame")?;
            let matrix = matrix.ok_or_else(|| frame.fault("cameraPoseARFrame is missing"))?;
            let pose = pose_of_opengl(&matrix);
            let pose = pose.ok_or_else(|| frame.fault("cameraPoseARFrame is no rotation and translation"))?;
            let [fx, skew, cx, _, fy, cy, _, _, _] = frame.array::<9>("intrinsics")?;
            let lens = Lens { size, focal: [fx, fy], principal: [cx, cy], skew, ..Lens::default() };
            Ok((lens.intrinsics(&path)?, pose))
        });
        if let Some((camera, pose)) = poses.keep("images", &stem, posed)? {
            poses.push(name, camera, pose, Vec::new());
        }
    }
    Ok(tracked(poses))
}

/// `metadata` of Record3D; images are named by their frame number, from 0.
pub(super) fn read_record3d(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let value = document(path)?;
    let all = Json { path, value: &value, place: "" };
    let list = |key: &str| value.get(key).and_then(serde_json::Value::as_array);
    let listed = list("poses").ok_or_else(|| all.fault("poses is missing"))?;
    let of_frames = list("perFrameIntrinsicCoeffs").filter(|of_frames| !of_frames.is_empty());
    if let Some(of_frames) = of_frames.filter(|of_frames| of_frames.len() != listed.len()) {
        return Err(all.fault(format!(
            "poses has {} frames, and perFrameIntrinsicCoeffs has {}; export the capture again",
            listed.len(),
            of_frames.len()
        )));
    }
    let size = (all.needed("w")? as u32, all.needed("h")? as u32);
    let camera = |index: usize| {
        let [fx, fy, cx, cy, skew] = if let Some(of_frames) = of_frames {
            let value = serde_json::json!({ "fx, fy, cx, cy": of_frames[index] });
            let coefficients = Json { path, value: &value, place: "perFrameIntrinsicCoeffs" };
            let [fx, fy, cx, cy] = coefficients.array("fx, fy, cx, cy")?;
            [fx, fy, cx, cy, 0.0]
        } else {
            // Column by column.
            let [fx, _, _, skew, fy, _, cx, cy, _] = all.array::<9>("K")?;
            [fx, fy, cx, cy, skew]
        };
        Lens { size, focal: [fx, fy], principal: [cx, cy], skew, ..Lens::default() }.intrinsics(path)
    };
    let mut poses = arkit();
    let mut images: Vec<(usize, String)> = Vec::new();
    for name in names.all() {
        match without_extension(name.rsplit('/').next().unwrap_or_default()).parse() {
            Ok(index) if index < listed.len() => images.push((index, name)),
            _ => poses.leave_out("images", &name, "their names are no numbers of a pose"),
        }
    }
    images.sort();
    for (index, name) in images {
        let place = format!("poses[{index}]");
        let fault = || faulty(path, format!("{place}: is no qx, qy, qz, qw, x, y, z"));
        let numbers: Vec<f64> =
            listed[index].as_array().into_iter().flatten().filter_map(serde_json::Value::as_f64).collect();
        let body = match numbers[..] {
            [qx, qy, qz, qw, x, y, z] => Stamped::new(index as f64, [qw, qx, qy, qz], [x, y, z]),
            _ => None,
        };
        let posed = body.ok_or_else(fault).and_then(|body| {
            let mut matrix = body.rotation.to_homogeneous();
            matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&body.position);
            Ok((camera(index)?, pose_of_opengl(&matrix).ok_or_else(fault)?))
        });
        if let Some((camera, pose)) = poses.keep("images", &place, posed)? {
            poses.push(name, camera, pose, Vec::new());
        }
    }
    Ok(tracked(poses))
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
