//! Merges two maps of one place: the images of one are localized in the other, and join it in its coordinate frame.

use veiloc_map::{MapModel, PosedImage};

use crate::build::append_images;
use crate::build::change::join;
use crate::build::diagnose::explain;
use crate::build::report::{BuildReport, MapWarning};
use crate::calibration::run::scale;
use crate::compress::refuse_compressed;
use crate::coordinate_frames::{MAX_TESTED, OtherCoordinateFrame, common_coordinate_frame};
use crate::error::MappingError;
use crate::input::cache::ExtractedFeatures;
use crate::progress::Progress;

/// Result of a merge.
#[derive(Debug)]
#[non_exhaustive]
pub struct MergeReport {
    /// Facts and warnings about the merged map.
    pub build: BuildReport,
    /// The transform of the second map's poses, and how many of its images agree on it.
    pub coordinate_frame: OtherCoordinateFrame,
    /// The same in the other direction: the first map's images localized in the second map. Its transform is the inverse.
    pub inverse: Option<OtherCoordinateFrame>,
    /// Distance between what the two directions make of the second map's camera centres, the median, map units.
    pub closure: Option<f64>,
}

/// Adds all images of another map to a map, in the map's coordinate frame. Their stored features are used, so no image is read; points of
/// both are triangulated again where images of both see them. The profile of the map stays, so queries that are sealed for it
/// remain valid. `prefix` is put before the names of the other map's images. An error leaves the map unchanged.
///
/// # Errors
/// [`MappingError::Alignment`]: the maps have another kind of descriptors, fewer than three images of the one are localized in
/// the other, or the images do not agree on one similarity. [`MappingError::NameInBothMaps`]: both maps have an image of
/// one name.
pub fn merge(
    model: &mut MapModel,
    other: &MapModel,
    prefix: &str,
    progress: &dyn Progress,
) -> Result<MergeReport, MappingError> {
    for map in [&*model, other] {
        map.validate()?;
        refuse_compressed(map)?;
    }
    let prefixed = |name: &str| format!("{prefix}{name}");
    if let Some(twice) = other.images.iter().find(|image| model.image_index(&prefixed(&image.name)).is_some())
    {
        return Err(MappingError::NameInBothMaps { name: prefixed(&twice.name) });
    }
    let frame = common_coordinate_frame(other, model, MAX_TESTED, progress)?;
    let inverse = common_coordinate_frame(model, other, MAX_TESTED, progress).ok();
    let closure = inverse.as_ref().map(|inverse| {
        let there_and_back = other.images.iter().map(|image| {
            let center = image.cam_from_world.center().coords;
            let back = inverse.map_from_given.transform(&frame.map_from_given.transform(&center));
            frame.map_from_given.scale * (back - center).norm()
        });
        crate::coordinate_frames::median(there_and_back.collect())
    });
    let posed: Vec<PosedImage> = other
        .images
        .iter()
        .map(|image| PosedImage {
            name: prefixed(&image.name),
            camera: other.cameras[image.camera],
            cam_from_world: frame.map_from_given.transform_pose(&image.cam_from_world),
            seen: Vec::new(),
        })
        .collect();
    let features = other.images.iter().map(|image| ExtractedFeatures {
        keypoints: image.keypoints.clone(),
        descriptors: image.descriptors.clone(),
        global: Some(image.global.clone()),
    });
    let before = model.images.len();
    append_images(model, &posed.iter().collect::<Vec<_>>(), features.collect())?;
    let edges = join(model, before, None, progress);
    let mut build = BuildReport::of(model, posed.len(), Vec::new(), edges.matches, edges.verified.len());
    explain(&mut build, model);
    build.warnings.extend(MapWarning::of_merge(frame.localized, closure, scale(model)));
    Ok(MergeReport { build, coordinate_frame: frame, inverse, closure })
}
