//! Writes a scene as a data set: the folders and lists that the readers of this crate, and other programs, read.

pub(crate) mod lists;
pub(crate) mod view;

use std::path::Path;

pub use self::view::{DatasetCamera, DatasetLayout, DatasetView, Split};
use crate::error::DatasetError;
use crate::{aachen, cambridge, seven_scenes};

/// Writes the lists and saves the images: `save` is called once for each view, in order, with the number of the view
/// and the path of its file, whose folder exists.
///
/// # Errors
/// [`DatasetError::Io`] with the file's name, and the errors of `save`.
pub fn write(
    layout: DatasetLayout,
    root: &Path,
    scene: &str,
    lens: &DatasetCamera,
    views: &[DatasetView],
    save: &mut dyn FnMut(usize, &Path) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    match layout {
        DatasetLayout::SevenScenes => seven_scenes::write(root, scene, lens, views, save),
        DatasetLayout::Cambridge => cambridge::write(root, scene, lens, views, save),
        DatasetLayout::Aachen => aachen::write(root, aachen::AachenVersion::V1, lens, views, save),
        DatasetLayout::AachenV1_1 => aachen::write(root, aachen::AachenVersion::V1_1, lens, views, save),
    }
}
