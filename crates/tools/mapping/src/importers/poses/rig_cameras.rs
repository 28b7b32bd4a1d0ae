//! Calibrations of rigs: cameras that are fixed to one device, with their poses on it.
//!
//! | file | pose in it | frame of the rig | unit |
//! |---|---|---|---|
//! | Kalibr, `camchain.yaml` | `T_cn_cnm1`: of the camera before, to this one; else `T_cam_imu` | the first camera | metres |
//! | COLMAP, `rig_config.json` (3.12) | `cam_from_rig_rotation` (`w x y z`), `cam_from_rig_translation` | the reference camera | any |
//! | COLMAP, the folder of a model with rigs | `rigs.txt`, `rigs.bin`: sensor from rig | the reference camera | of the model |
//!
//! Axes are right, down, forward. `rig_config.json` has no size of the images: it is that of the camera's image.
//!
//! Sources: <https://github.com/ethz-asl/kalibr/wiki/yaml-formats>, <https://colmap.github.io/rigs.html>.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde_json::Value;
use veiloc_features::image_size;
use veiloc_geometry::frames::{Camera, Rigid3};
use veiloc_geometry::{CameraFromRig, Intrinsics};
use veiloc_map::colmap::{ColmapSensor, SensorKind, read_model};
use veiloc_map::{PosedImage, PosedImages};

use super::json::{Json, document};
use super::posed_input::{faulty, text};
use super::sensor_yaml::Sensor;
use crate::error::MappingError;
use crate::input::image_names::image_file;

/// A camera of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct RigCamera {
    /// Its name in the file: the key of Kalibr's, or the folder of its images.
    pub name: String,
    /// Its pose on the rig.
    pub cam_from_rig: CameraFromRig,
    lens: RigLens,
    /// The file, for messages.
    path: PathBuf,
}

#[derive(Debug, Clone, PartialEq)]
enum RigLens {
    Whole(Intrinsics),
    /// Model and parameters.
    WithoutSize(String, Vec<f64>),
}

impl RigCamera {
    /// The camera of its images, which have this width and height.
    ///
    /// # Errors
    /// [`MappingError::Poses`]: the calibration is of another size, or has an invalid parameter.
    pub fn camera(&self, (width, height): (u32, u32)) -> Result<Intrinsics, MappingError> {
        let fault = |reason: String| faulty(&self.path, format!("{}: {reason}", self.name));
        match &self.lens {
            RigLens::Whole(camera) if (camera.width, camera.height) == (width, height) => Ok(*camera),
            RigLens::Whole(camera) => Err(fault(format!(
                "the camera is calibrated for {}x{}, and its image has {width}x{height} pixels; give the images in the order \
                 of the cameras, in the size of the calibration",
                camera.width, camera.height
            ))),
            RigLens::WithoutSize(model, params) => {
                Intrinsics::new(model, width, height, params).map_err(|e| fault(e.to_string()))
            }
        }
    }
}

/// Reads the calibration of a rig, in the order of the file.
///
/// # Errors
/// [`MappingError`]: the file cannot be read, has no rig or several, or has a camera without pose, of an unknown model or with an
/// invalid parameter.
pub fn read_rig_cameras(path: &Path) -> Result<Vec<RigCamera>, MappingError> {
    let cameras = if path.is_dir() {
        of_model(path)?
    } else if text(path)?.trim_start().starts_with(['[', '{']) {
        of_rig_config(path)?
    } else {
        of_kalibr(path)?
    };
    if cameras.len() < 2 {
        return Err(faulty(
            path,
            "a rig has at least two cameras; give the image of a single one with --camera",
        ));
    }
    Ok(cameras)
}

/// Gives all images of a rig their cameras and poses, from the poses of its reference camera: that whose pose on the rig is the
/// identity. Images of one moment have one name in the folders of their cameras, which are called as the cameras: `cam0/17.png`,
/// `cam1/17.png`. Images that are in none of these folders stay as they are. Lengths of the rig are those of the poses.
///
/// # Errors
/// [`MappingError::Poses`]: no posed image is of the reference camera, or a camera is not that of its images.
pub fn pose_rig_images(
    posed: &PosedImages,
    cameras: &[RigCamera],
    images: &Path,
) -> Result<PosedImages, MappingError> {
    let of =
        |camera: &RigCamera, name: &str| Some(name.strip_prefix(&camera.name)?.strip_prefix('/')?.to_owned());
    let reference = cameras.iter().find(|camera| camera.cam_from_rig == CameraFromRig::identity());
    let reference = reference.or(cameras.first()).ok_or(MappingError::EmptyList)?;
    let rig_from_cam = reference.cam_from_rig.inverse();
    let is_on_rig = |name: &str| cameras.iter().any(|camera| of(camera, name).is_some());
    let mut all: Vec<PosedImage> = posed.images().iter().filter(|i| !is_on_rig(&i.name)).cloned().collect();
    let others = all.len();
    for camera in cameras {
        let mut intrinsics = None;
        for image in posed.images() {
            let Some(moment) = of(reference, &image.name) else { continue };
            let name = format!("{}/{moment}", camera.name);
            let file = image_file(images, &name);
            if !file.is_file() {
                continue;
            }
            let own = match intrinsics {
                Some(own) => own,
                None => camera.camera(image_size(&file)?)?,
            };
            intrinsics = Some(own);
            let cam_from_world = camera.cam_from_rig.compose(&rig_from_cam).compose(&image.cam_from_world);
            let seen = if camera.name == reference.name { image.seen.clone() } else { Vec::new() };
            all.push(PosedImage { name, camera: own, cam_from_world, seen });
        }
    }
    if all.len() == others {
        let (path, name) = (&reference.path, &reference.name);
        return Err(faulty(
            path,
            format!(
                "no image with a pose is in a folder {name}/ of {}: images of one moment are {name}/NAME and in the \
                     folders of the other cameras, with the same NAME",
                images.display()
            ),
        ));
    }
    let known: BTreeSet<&str> = all.iter().map(|image| image.name.as_str()).collect();
    let apart = posed.images().iter().filter(|image| !known.contains(image.name.as_str())).count();
    let mut remarks = posed.remarks().to_vec();
    if apart > 0 {
        remarks.push(format!(
            "{apart} images of the rig are left out: no image in {}/ has their name",
            reference.name
        ));
    }
    Ok(PosedImages::new(all, posed.points().to_vec())?.with_remarks(remarks))
}

fn of_kalibr(path: &Path) -> Result<Vec<RigCamera>, MappingError> {
    let content = text(path)?;
    let blocks = Sensor::blocks(path, &content);
    // The other blocks are of inertial sensors.
    let number = |block: &Sensor<'_>| block.name.strip_prefix("cam")?.parse::<usize>().ok();
    let mut blocks: Vec<_> = blocks.iter().filter_map(|block| Some((number(block)?, block))).collect();
    blocks.sort_by_key(|(number, _)| *number);
    if blocks.is_empty() {
        let read = "camchain.yaml of Kalibr, rig_config.json of COLMAP and the folder of a COLMAP model with rigs are read";
        return Err(faulty(path, format!("no calibration of a rig: there is no cam0; {read}")));
    }
    let pose = |block: &Sensor<'_>, key: &str| {
        let matrix = block.matrix(key)?;
        let (rotation, translation) = (matrix.fixed_view::<3, 3>(0, 0), matrix.fixed_view::<3, 1>(0, 3));
        Rigid3::<Camera, Camera>::from_matrix(rotation.into_owned(), translation.into_owned())
            .ok_or_else(|| faulty(path, format!("{}: {key} is no rotation and translation", block.name)))
    };
    // The first camera is the rig.
    let mut cam_from_rig = CameraFromRig::identity();
    let mut cameras = Vec::new();
    for (at, (number, block)) in blocks.iter().enumerate() {
        if *number != at {
            return Err(faulty(path, format!("cam{at} is missing")));
        }
        if at > 0 && block.has("T_cn_cnm1") {
            cam_from_rig = pose(block, "T_cn_cnm1")?.compose(&cam_from_rig);
        } else if at > 0 && block.has("T_cam_imu") && blocks[0].1.has("T_cam_imu") {
            let imu_from_first = pose(blocks[0].1, "T_cam_imu")?.inverse();
            cam_from_rig =
                pose(block, "T_cam_imu")?.compose(&imu_from_first).compose(&CameraFromRig::identity());
        } else if at > 0 {
            let reason = "T_cn_cnm1 is missing, and so is T_cam_imu of it or of cam0";
            return Err(faulty(path, format!("{}: {reason}", block.name)));
        }
        let lens = RigLens::Whole(block.intrinsics("distortion_coeffs")?);
        cameras.push(RigCamera { name: block.name.to_owned(), cam_from_rig, lens, path: path.to_owned() });
    }
    Ok(cameras)
}

fn of_rig_config(path: &Path) -> Result<Vec<RigCamera>, MappingError> {
    let value = document(path)?;
    let rigs = value.as_array().map_or(&[] as &[Value], Vec::as_slice);
    let [rig] = rigs else {
        let found = rigs.len();
        return Err(faulty(path, format!("{found} rigs; leave one in the list, whose images are given")));
    };
    let listed = rig.get("cameras").and_then(Value::as_array).map_or(&[] as &[Value], Vec::as_slice);
    let camera = |(at, value): (usize, &Value)| {
        let place = format!("cameras[{at}]");
        let json = Json { path, value, place: &place };
        let is_reference = value.get("ref_sensor").and_then(Value::as_bool) == Some(true);
        let cam_from_rig = if is_reference {
            CameraFromRig::identity()
        } else {
            let (q, t) = (json.array("cam_from_rig_rotation")?, json.array("cam_from_rig_translation")?);
            CameraFromRig::from_quaternion(q, t)
                .ok_or_else(|| json.fault("the pose is not a rotation and translation"))?
        };
        let params = json.numbers("camera_params")?.ok_or_else(|| {
            json.fault("camera_params and camera_model_name are missing; add them, or give the folder of a model with rigs")
        })?;
        let lens = RigLens::WithoutSize(json.text("camera_model_name")?.to_owned(), params);
        let name = json.text("image_prefix")?.trim_matches('/').to_owned();
        Ok(RigCamera { name, cam_from_rig, lens, path: path.to_owned() })
    };
    listed.iter().enumerate().map(camera).collect()
}

fn of_model(folder: &Path) -> Result<Vec<RigCamera>, MappingError> {
    let model = read_model(folder)?;
    let rigs = model.rigs().map_or(&[] as &[_], |rigs| rigs.rigs.as_slice());
    let rigs: Vec<_> = rigs.iter().filter(|rig| !rig.sensors.is_empty()).collect();
    let [rig] = rigs.as_slice() else {
        let found = rigs.len();
        return Err(faulty(
            folder,
            format!("{found} rigs of several sensors in this model, and one is expected"),
        ));
    };
    let sensors = rig.reference.into_iter().chain(rig.sensors.iter().map(|(sensor, _)| *sensor));
    let cameras = sensors.filter(|sensor| sensor.kind == SensorKind::Camera).map(|sensor: ColmapSensor| {
        // Where its images are.
        let image = model.images().iter().find(|image| image.camera_id == sensor.id);
        let above = image.and_then(|image| image.name.rsplit_once('/')).map(|(above, _)| above.to_owned());
        let name = above.unwrap_or_else(|| format!("camera-{}", sensor.id));
        let pose = rig.sensor_from_rig(sensor);
        let cam_from_rig =
            pose.ok_or_else(|| faulty(folder, format!("camera {} has no pose on the rig", sensor.id)))?;
        let camera = model.cameras().get(&sensor.id);
        let camera =
            camera.ok_or_else(|| faulty(folder, format!("camera {} of the rig is missing", sensor.id)))?;
        Ok(RigCamera { name, cam_from_rig, lens: RigLens::Whole(*camera), path: folder.to_owned() })
    });
    cameras.collect()
}
