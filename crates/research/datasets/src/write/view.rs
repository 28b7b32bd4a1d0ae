//! What is written: the layout of a data set, its views and their camera.

use std::path::PathBuf;
use std::str::FromStr;

use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_mapping::importers::poses::nvm::radial_camera;

use crate::error::DatasetError;

/// The layout of a data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DatasetLayout {
    /// 7Scenes, with both sources of poses.
    SevenScenes,
    /// Cambridge Landmarks.
    Cambridge,
    /// Aachen Day-Night v1.
    Aachen,
    /// Aachen Day-Night v1.1.
    AachenV1_1,
}

impl DatasetLayout {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::SevenScenes, Self::Cambridge, Self::Aachen, Self::AachenV1_1];

    /// Its name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SevenScenes => "7scenes",
            Self::Cambridge => "cambridge",
            Self::Aachen => "aachen",
            Self::AachenV1_1 => "aachen-v1.1",
        }
    }
}

impl FromStr for DatasetLayout {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let known = Self::ALL.into_iter().find(|layout| layout.name() == text);
        known
            .ok_or_else(|| format!("{text:?} is not a layout; use 7scenes, cambridge, aachen or aachen-v1.1"))
    }
}

/// A view of the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DatasetView {
    /// Its pose.
    pub cam_from_world: CameraFromWorld,
    /// What the data set uses it for.
    pub split: Split,
}

/// What a data set uses a view for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Split {
    /// A map image.
    Map,
    /// A query.
    Query,
    /// A query at night, if the layout has conditions; otherwise an ordinary query.
    NightQuery,
}

/// Camera parameters that a layout can store, in pixels of an image of this size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DatasetCamera {
    /// Focal length, pixels.
    pub focal: f64,
    /// `r` of an NVM file; 0 for 7Scenes, which has no distortion.
    pub distortion: f64,
    /// Width and height, pixels.
    pub size: (u32, u32),
}

impl DatasetCamera {
    /// Parameters for an image of this size, with the field of view of the data set's own images.
    pub fn of(layout: DatasetLayout, size: (u32, u32)) -> Self {
        let (focal, distortion) = match layout {
            DatasetLayout::SevenScenes => (525.0 / 640.0, 0.0),
            DatasetLayout::Cambridge => (1670.0 / 1920.0, 0.02),
            DatasetLayout::Aachen | DatasetLayout::AachenV1_1 => (1084.59 / 1600.0, 0.0811),
        };
        Self { focal: focal * f64::from(size.0), distortion, size }
    }

    /// The camera that a reader returns for it.
    ///
    /// # Errors
    /// [`DatasetError::Unusable`] for an empty image.
    pub fn camera(&self) -> Result<Intrinsics, DatasetError> {
        radial_camera(self.focal, self.distortion, self.size)
            .map_err(|e| DatasetError::Unusable { path: PathBuf::new(), reason: e.to_string() })
    }
}
