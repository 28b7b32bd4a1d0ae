//! Rigs and frames, which COLMAP 3.12 and newer write beside cameras and images.
//!
//! A rig has sensors with fixed poses on it; a frame is one exposure of a rig, and names the images that belong to it.
//! Where a model has these files, they hold its poses (`sensor_from_rig ∘ rig_from_world`), and COLMAP does not read the
//! poses in `images`.

use std::collections::{BTreeMap, BTreeSet};

use veiloc_geometry::{CameraFromRig, CameraFromWorld, RigFromWorld};

use super::records::ColmapImage;

/// Kind of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum SensorKind {
    /// A camera; its data are images.
    Camera,
    /// An inertial measurement unit.
    Imu,
}

impl SensorKind {
    /// COLMAP's words, at the index of its numbers.
    const NAMES: [(&str, Self); 2] = [("CAMERA", Self::Camera), ("IMU", Self::Imu)];

    pub(super) fn of_name(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|row| row.0 == name).map(|row| row.1)
    }

    pub(super) fn of_number(number: u32) -> Option<Self> {
        Self::NAMES.get(number as usize).map(|row| row.1)
    }

    pub(super) const fn name(self) -> &'static str {
        Self::NAMES[self.number() as usize].0
    }

    pub(super) const fn number(self) -> u32 {
        match self {
            Self::Camera => 0,
            Self::Imu => 1,
        }
    }
}

/// A sensor: its kind and COLMAP's id, for a camera that of its intrinsics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct ColmapSensor {
    /// What it measures with.
    pub kind: SensorKind,
    /// Its id among the sensors of its kind.
    pub id: u32,
}

impl ColmapSensor {
    /// The camera with this id.
    pub const fn camera(id: u32) -> Self {
        Self { kind: SensorKind::Camera, id }
    }
}

/// Sensors that move together.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapRig {
    /// COLMAP's id of the rig.
    pub id: u32,
    /// The sensor whose frame is that of the rig; `None` for a rig without sensors.
    pub reference: Option<ColmapSensor>,
    /// The other sensors with their poses on the rig, where they are known.
    pub sensors: Vec<(ColmapSensor, Option<CameraFromRig>)>,
}

impl ColmapRig {
    /// Pose of a sensor on the rig; `None` if it is not known, or if the sensor is not on the rig.
    pub fn sensor_from_rig(&self, sensor: ColmapSensor) -> Option<CameraFromRig> {
        if self.reference == Some(sensor) {
            return Some(CameraFromRig::identity());
        }
        self.sensors.iter().find(|(own, _)| *own == sensor).and_then(|(_, pose)| *pose)
    }
}

/// One exposure of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapFrame {
    /// COLMAP's id of the frame.
    pub id: u32,
    /// COLMAP's id of its rig.
    pub rig_id: u32,
    /// Pose of the rig.
    pub rig_from_world: RigFromWorld,
    /// What its sensors measured: for a camera the id of the image.
    pub data: Vec<(ColmapSensor, u64)>,
}

/// The rigs and frames of a model.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ColmapRigs {
    /// The rigs, in the order of the file.
    pub rigs: Vec<ColmapRig>,
    /// The frames, in the order of the file.
    pub frames: Vec<ColmapFrame>,
}

impl ColmapRigs {
    /// A rig for each camera and a frame for each image: how COLMAP describes images that do not move together.
    pub fn trivial(cameras: impl IntoIterator<Item = u32>, images: &[ColmapImage]) -> Self {
        let rigs = cameras.into_iter().map(|id| ColmapRig {
            id,
            reference: Some(ColmapSensor::camera(id)),
            sensors: Vec::new(),
        });
        let frames = images.iter().map(|image| ColmapFrame {
            id: image.id,
            rig_id: image.camera_id,
            rig_from_world: CameraFromRig::identity().inverse().compose(&image.cam_from_world),
            data: vec![(ColmapSensor::camera(image.camera_id), image.id.into())],
        });
        Self { rigs: rigs.collect(), frames: frames.collect() }
    }

    /// Checks that ids are unique, and that each frame has its rig.
    pub(super) fn check(&self) -> Result<(), String> {
        let (mut ids, mut sensors) = (BTreeSet::new(), BTreeSet::new());
        for rig in &self.rigs {
            if !ids.insert(rig.id) {
                return Err(format!("rig {} is defined twice; keep one of them", rig.id));
            }
            for sensor in rig.reference.iter().chain(rig.sensors.iter().map(|(sensor, _)| sensor)) {
                if !sensors.insert(*sensor) {
                    let (name, id) = (sensor.kind.name(), sensor.id);
                    return Err(format!("sensor {name} {id} is on two rigs; keep it on one of them"));
                }
            }
        }
        let mut images = BTreeSet::new();
        let mut frames = BTreeSet::new();
        for frame in &self.frames {
            if !frames.insert(frame.id) {
                return Err(format!("frame {} is defined twice; keep one of them", frame.id));
            }
            if !ids.contains(&frame.rig_id) {
                return Err(format!(
                    "frame {} has rig {}, which rigs does not have; add it",
                    frame.id, frame.rig_id
                ));
            }
            for (sensor, image) in &frame.data {
                if sensor.kind == SensorKind::Camera && !images.insert(*image) {
                    return Err(format!("image {image} is in two frames; keep it in one of them"));
                }
            }
        }
        Ok(())
    }

    /// Poses of the images by their id, as far as rigs and frames tell them.
    pub(super) fn poses(&self) -> BTreeMap<u64, CameraFromWorld> {
        let rigs: BTreeMap<u32, &ColmapRig> = self.rigs.iter().map(|rig| (rig.id, rig)).collect();
        let mut poses = BTreeMap::new();
        for frame in &self.frames {
            let Some(rig) = rigs.get(&frame.rig_id) else { continue };
            for (sensor, image) in frame.data.iter().filter(|(sensor, _)| sensor.kind == SensorKind::Camera) {
                if let Some(cam_from_rig) = rig.sensor_from_rig(*sensor) {
                    poses.insert(*image, cam_from_rig.compose(&frame.rig_from_world));
                }
            }
        }
        poses
    }
}
