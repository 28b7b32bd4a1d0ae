//! Posed images of other programs: one file a format, and the recognition of the format.
//!
//! | format | file | pose in the file | axes of the camera | pixels |
//! |---|---|---|---|---|
//! | COLMAP | `cameras`, `images` | world to camera | right, down, forward | corner |
//! | nerfstudio, instant-ngp | `transforms.json` | camera to world | right, up, backward | corner |
//! | Bundler | `bundle.out` and its list | world to camera | right, up, backward | from the middle |
//! | VisualSFM | `.nvm` | centre, world to camera | right, down, forward | from the middle |
//! | OpenSfM, OpenDroneMap | `reconstruction.json` | world to camera | right, down, forward | from the middle, in sides |
//! | Metashape | cameras as XML | camera to chunk | right, down, forward | from the middle |
//! | RealityCapture | Internal/External camera parameters, CSV | heading, pitch, roll | right, up, backward | from the middle, 36 mm |
//! | kapture | `sensors/` | world to camera | right, down, forward | corner |
//! | TUM | `time tx ty tz qx qy qz qw` | camera to world | right, down, forward | corner (`cameras.txt`) |
//! | KITTI | 12 numbers a line, `calib.txt` | camera 0 to world | right, down, forward | centre of the first |
//! | EuRoC | `mav0` | body to world, camera to body | right, down, forward | centre of the first |
//! | AR captures | Polycam, Record3D, 3D Scanner App | camera to world | right, up, backward | corner |
//!
//! Bags of ROS become a COLMAP model first: [`frames_of_bag`](super::ros_bag::frames_of_bag).
//!
//! Each reader states its source. What is read correctly is kept: an odd item is left out, and a remark counts it with the
//! reason; a file is refused if nothing is left, or if its structure is damaged. Images are found in the folder of the images
//! whatever path or extension the other program gave them ([`PosedInput::images`] has names relative to that folder).
//!
//! ```no_run
//! use std::path::Path;
//! use veiloc_mapping::importers::poses::read_posed;
//!
//! let read = read_posed(Path::new("hall/transforms.json"), Path::new("hall/images"))?;
//! println!("{} images of {}", read.images.images().len(), read.format);
//! # Ok::<(), veiloc_mapping::MappingError>(())
//! ```

mod ar_capture;
mod bundler;
mod cameras;
mod colmap;
mod euroc;
mod json;
mod kapture;
mod kitti;
mod metashape;
mod names;
mod nerfstudio;
pub mod nvm;
mod opensfm;
mod posed_input;
mod radial;
mod reality_capture;
mod recognize;
mod rig_cameras;
mod sensor_yaml;
mod times;
mod tum;

use std::path::Path;

use self::names::ImageNames;
use self::posed_input::Poses;
pub use self::posed_input::{PoseFormat, PosedInput};
use self::recognize::recognize;
pub use self::rig_cameras::{RigCamera, pose_rig_images, read_rig_cameras};
use crate::error::MappingError;

/// Reads posed images of any format of [`PoseFormat`]. `images` is the folder of the images: names are relative to it,
/// and it has the sizes of images that a format does not have.
///
/// # Errors
/// [`MappingError`]: [`MappingError::UnknownPoses`] if no format is recognized, [`MappingError::AmbiguousPoses`] if
/// several are, and the error of the reader, which names the file and the place in it.
pub fn read_posed(path: &Path, images: &Path) -> Result<PosedInput, MappingError> {
    let (format, path) = recognize(path)?;
    let read: fn(&Path, &ImageNames) -> Result<Poses, MappingError> = match format {
        PoseFormat::Colmap => return colmap::read(&path),
        PoseFormat::Nerfstudio => nerfstudio::read,
        PoseFormat::Bundler => bundler::read,
        PoseFormat::Nvm => nvm::read,
        PoseFormat::OpenSfm => opensfm::read,
        PoseFormat::Metashape => metashape::read,
        PoseFormat::RealityCapture => reality_capture::read,
        PoseFormat::Kapture => kapture::read,
        PoseFormat::Tum => tum::read,
        PoseFormat::Kitti => kitti::read,
        PoseFormat::Euroc => euroc::read,
        PoseFormat::Polycam => ar_capture::read_polycam,
        PoseFormat::Record3d => ar_capture::read_record3d,
        PoseFormat::ScannerApp => ar_capture::read_scanner_app,
    };
    let names = ImageNames::new(images);
    let mut poses = read(&path, &names)?;
    let misplaced = names.misplaced();
    let names = if misplaced.is_empty() {
        names
    } else {
        let names = names.without(misplaced.clone());
        poses = read(&path, &names)?;
        names
    };
    let is_misplaced = |written: &str| misplaced.contains(&names::cleaned(written));
    let misplaced_in = format!(
        "they are in another folder than {}, which has other images of their names; give the folder that these paths are \
         relative to",
        images.display()
    );
    let alike_in = format!(
        "several files in {} have their names; give the folder of one of them, or make the names unique",
        images.display()
    );
    let listed = std::mem::take(&mut poses.images);
    let without_file = std::mem::take(&mut poses.without_file);
    for (name, image) in listed
        .into_iter()
        .map(|image| (image.name.clone(), Some(image)))
        .chain(without_file.into_iter().map(|name| (name, None)))
    {
        match (names.alike(&name), image) {
            _ if is_misplaced(&name) => poses.leave_out("images", &name, &misplaced_in),
            (Some(files), _) => {
                poses.leave_out("images", &format!("{name} ({})", files.join(", ")), &alike_in);
            }
            (None, Some(image)) => poses.images.push(image),
            (None, None) => poses.without_file.push(name),
        }
    }
    poses.finish(format, path)
}

/// Names of all image files in a folder and its folders, relative to it, sorted.
pub(crate) fn image_names(folder: &Path) -> Vec<String> {
    ImageNames::new(folder).all()
}

pub(crate) use self::colmap::numbered as numbered_models;
