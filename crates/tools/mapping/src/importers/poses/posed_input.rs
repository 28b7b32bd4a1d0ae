//! Posed images as a reader collects them and returns them, and what several readers share.

use std::fmt;
use std::path::{Path, PathBuf};

use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix3, Matrix4, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Point3};
use veiloc_map::{GravityDirection, PosedImage, PosedImages};

use crate::error::MappingError;

/// A format of posed images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum PoseFormat {
    /// A COLMAP model.
    Colmap,
    /// `transforms.json` of nerfstudio or instant-ngp.
    Nerfstudio,
    /// A Bundler file.
    Bundler,
    /// A VisualSFM model.
    Nvm,
    /// `reconstruction.json` of OpenSfM.
    OpenSfm,
    /// Cameras of Metashape as XML.
    Metashape,
    /// Camera parameters of RealityCapture as CSV.
    RealityCapture,
    /// A kapture folder.
    Kapture,
    /// A trajectory in the form of TUM.
    Tum,
    /// Poses of KITTI's odometry benchmark.
    Kitti,
    /// A sequence of EuRoC (ASL).
    Euroc,
    /// A raw capture of Polycam: a JSON file for each image.
    Polycam,
    /// A capture of Record3D: `metadata`.
    Record3d,
    /// A capture of 3D Scanner App: a JSON file for each image.
    ScannerApp,
}

impl fmt::Display for PoseFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Colmap => "a COLMAP model",
            Self::Nerfstudio => "nerfstudio's transforms.json",
            Self::Bundler => "a Bundler file",
            Self::Nvm => "a VisualSFM model",
            Self::OpenSfm => "OpenSfM's reconstruction.json",
            Self::Metashape => "Metashape's cameras",
            Self::RealityCapture => "RealityCapture's camera parameters",
            Self::Kapture => "a kapture folder",
            Self::Tum => "a trajectory in TUM's format",
            Self::Kitti => "poses of KITTI",
            Self::Euroc => "a sequence of EuRoC",
            Self::Polycam => "a raw capture of Polycam",
            Self::Record3d => "a capture of Record3D",
            Self::ScannerApp => "a capture of 3D Scanner App",
        })
    }
}

/// Posed images, and what the file says about their world frame.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct PosedInput {
    /// The images with their cameras and poses; [`PosedImages::remarks`] has what was left out or assumed.
    pub images: PosedImages,
    /// The format that was recognized.
    pub format: PoseFormat,
    /// The file or folder that was read; of a folder with several files, the one that has the poses.
    pub path: PathBuf,
    /// The direction of gravity in the world frame, if the format defines it.
    pub down: Option<GravityDirection>,
    /// Whether the format defines that lengths are metres: AR captures, EuRoC, and OpenSfM with a reference.
    pub is_metric: bool,
}

/// Images and points as a reader collects them.
#[derive(Debug, Default)]
pub(super) struct Poses {
    pub(super) images: Vec<PosedImage>,
    pub(super) points: Vec<Point3<World>>,
    pub(super) remarks: Vec<String>,
    pub(super) down: Option<GravityDirection>,
    /// Images whose size is needed and whose file does not exist, as the file names them.
    pub(super) without_file: Vec<String>,
}

impl Poses {
    pub(super) fn push(
        &mut self,
        name: String,
        camera: Intrinsics,
        cam_from_world: CameraFromWorld,
        seen: Vec<u32>,
    ) {
        self.images.push(PosedImage { name, camera, cam_from_world, seen });
    }

    pub(super) fn finish(mut self, format: PoseFormat, path: PathBuf) -> Result<PosedInput, MappingError> {
        if let Some(first) = self.without_file.first() {
            let count = self.without_file.len();
            let reason = format!(
                "{count} images have no file in the folder of the images, which has their sizes; the first is {first}"
            );
            if self.images.is_empty() {
                return Err(faulty(&path, format!("{reason}; check the folder of the images")));
            }
            self.remarks.push(format!("left out: {reason}"));
        }
        if self.images.is_empty() {
            return Err(faulty(&path, "has no image with a pose".to_owned()));
        }
        let images = PosedImages::new(self.images, self.points)?.with_remarks(self.remarks);
        let is_metric = match format {
            PoseFormat::Polycam | PoseFormat::Record3d | PoseFormat::ScannerApp | PoseFormat::Euroc => true,
            // Its frame is then east, north, up.
            PoseFormat::OpenSfm => self.down.is_some(),
            _ => false,
        };
        Ok(PosedInput { images, format, path, down: self.down, is_metric })
    }
}

/// The error for content that cannot be used.
pub(super) fn faulty(path: &Path, reason: impl Into<String>) -> MappingError {
    MappingError::Poses { path: path.to_owned(), reason: reason.into() }
}

/// Reads a text file.
pub(super) fn text(path: &Path) -> Result<String, MappingError> {
    veiloc_map::text::read_text(path).map_err(MappingError::io(path))
}

/// A pose from a camera-to-world matrix whose camera axes are right, down, forward; the last row is not used.
pub(super) fn pose_of_world_from_cam(matrix: &Matrix4<f64>) -> Option<CameraFromWorld> {
    let rotation: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    let center: Vector3<f64> = matrix.fixed_view::<3, 1>(0, 3).into_owned();
    let world_from_cam = CameraFromWorld::from_matrix(rotation, center)?;
    let rotation = world_from_cam.rotation().inverse();
    Some(CameraFromWorld::new(rotation, -(rotation * center)))
}

/// The same for camera axes right, up, backward, as of OpenGL, ARKit and ARCore.
pub(super) fn pose_of_opengl(matrix: &Matrix4<f64>) -> Option<CameraFromWorld> {
    let mut matrix = *matrix;
    for column in 1..3 {
        matrix.column_mut(column).neg_mut();
    }
    pose_of_world_from_cam(&matrix)
}

/// An axis of the world that points down.
pub(super) fn down(x: f64, y: f64, z: f64) -> Option<GravityDirection> {
    GravityDirection::new([x, y, z]).ok()
}
