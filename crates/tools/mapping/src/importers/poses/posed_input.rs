//! Posed images as a reader collects them and returns them, and what several readers share.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix3, Matrix4, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Point3};
use veiloc_map::{GravityDirection, MapError, PosedImage, PosedImages};

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
///
/// What is odd is left out and counted ([`Poses::keep`], [`Poses::leave_out`]); a reader refuses a file only if that makes
/// all of it meaningless.
#[derive(Debug, Default)]
pub(super) struct Poses {
    pub(super) images: Vec<PosedImage>,
    pub(super) points: Vec<Point3<World>>,
    pub(super) remarks: Vec<String>,
    pub(super) down: Option<GravityDirection>,
    /// Images whose size is needed and whose file does not exist, as the file names them.
    pub(super) without_file: Vec<String>,
    pub(super) left_out: Vec<LeftOut>,
    /// Number of items that are left out for further reasons.
    pub(super) more_left_out: usize,
}

/// Items that are left out for one reason.
#[derive(Debug)]
pub(super) struct LeftOut {
    /// What they are, in the plural.
    items: &'static str,
    reason: String,
    count: usize,
    first: String,
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

    /// Counts one of `items`, which is called `item`, as left out.
    pub(super) fn leave_out(&mut self, items: &'static str, item: &str, reason: &str) {
        let is_full = self.left_out.len() == MAX_REASONS;
        match self.left_out.iter_mut().find(|group| group.items == items && group.reason == reason) {
            Some(group) => group.count += 1,
            // A long file may have another reason in each line.
            None if is_full => self.more_left_out += 1,
            None => self.left_out.push(LeftOut {
                items,
                reason: reason.to_owned(),
                count: 1,
                first: item.to_owned(),
            }),
        }
    }

    /// The value of an item; `None`, and the item is left out, if the file has something odd there.
    ///
    /// # Errors
    /// A file cannot be read.
    pub(super) fn keep<T>(
        &mut self,
        items: &'static str,
        item: &str,
        value: Result<T, MappingError>,
    ) -> Result<Option<T>, MappingError> {
        match value {
            Ok(value) => Ok(Some(value)),
            Err(MappingError::Poses { reason, .. } | MappingError::PosesLine { reason, .. }) => {
                let reason =
                    reason.strip_prefix(item).and_then(|rest| rest.strip_prefix(": ")).unwrap_or(&reason);
                self.leave_out(items, item, reason);
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    pub(super) fn finish(mut self, format: PoseFormat, path: PathBuf) -> Result<PosedInput, MappingError> {
        for written in std::mem::take(&mut self.without_file) {
            self.leave_out(
                "images",
                &written,
                "they have no file in the folder of the images, which has their sizes",
            );
        }
        self.leave_out_unusable();
        self.leave_out_repeated();
        self.remarks.extend(self.left_out.iter().map(LeftOut::to_string));
        if self.more_left_out > 0 {
            self.remarks.push(format!("{} more items are left out for other reasons", self.more_left_out));
        }
        if self.images.is_empty() {
            let why = if self.remarks.is_empty() { "" } else { ": " };
            return Err(faulty(&path, format!("has no image with a pose{why}{}", self.remarks.join("; "))));
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

    /// Leaves out images that no map can have: without a name, or with a pose that is not finite.
    fn leave_out_unusable(&mut self) {
        for image in std::mem::take(&mut self.images) {
            let alone = PosedImage { seen: Vec::new(), ..image.clone() };
            match PosedImages::new(vec![alone], Vec::new()) {
                Err(MapError::PosedImages { reason, .. }) => {
                    self.leave_out("images", &image.name, &format!("each {reason}"));
                }
                _ => self.images.push(image),
            }
        }
    }

    /// Of images that are listed twice, keeps the first if all entries are equal, and none if they are not.
    fn leave_out_repeated(&mut self) {
        let mut entries: BTreeMap<String, Vec<PosedImage>> = BTreeMap::new();
        let order: Vec<String> = self.images.iter().map(|image| image.name.clone()).collect();
        for image in std::mem::take(&mut self.images) {
            entries.entry(image.name.clone()).or_default().push(image);
        }
        for name in order {
            let Some(mut of_name) = entries.remove(&name) else { continue };
            let first = of_name.swap_remove(0);
            let is_same = |other: &PosedImage| {
                other.cam_from_world == first.cam_from_world && other.camera == first.camera
            };
            if of_name.iter().all(is_same) {
                for _ in &of_name {
                    self.leave_out("entries", &name, "their image is listed before with the same pose");
                }
                self.images.push(first);
            } else {
                self.leave_out(
                    "images",
                    &name,
                    "several poses or cameras are given for one file; keep one of them",
                );
            }
        }
    }
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { items, reason, count, first } = self;
        write!(f, "{count} {items} are left out: {reason}; the first is {first}")
    }
}

/// Number of reasons that are listed.
const MAX_REASONS: usize = 12;

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
