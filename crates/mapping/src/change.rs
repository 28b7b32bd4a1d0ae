//! Images join a map and leave it, without the map being built again.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use veiloc_map::colmap::{ColmapImage, ColmapModel};
use veiloc_map::{MapModel, Observation};

use crate::build::{append_images, match_images};
use crate::complete::grow;
use crate::error::MappingError;
use crate::extract::{Extracted, extract_all, select};
use crate::options::BuildOptions;
use crate::pairs::Seeds;
use crate::progress::Progress;
use crate::scene::{Fallback, Scene};

/// Adds the named images, whose poses and cameras the model `posed` holds, in the frame of the map.
///
/// Features are extracted as they were for the map, and matched with images that see the same. Points that gain
/// observations are refined, new points are added behind the old ones; all others, the vocabulary and the profile stay
/// as they are, bit for bit. An error leaves the map as it was.
///
/// # Errors
/// [`MappingError`] as for [`build`](crate::build), and when an image is already in the map.
pub fn add(
    model: &mut MapModel,
    posed: &ColmapModel,
    image_dir: &Path,
    names: &[String],
    progress: &dyn Progress,
) -> Result<(), MappingError> {
    model.validate()?;
    let chosen = select(posed, names)?;
    if let Some(there) = chosen.iter().find(|i| model.image_index(&i.name).is_some()) {
        return Err(MappingError::AlreadyInMap { name: there.name.clone() });
    }
    let features = extract_all(&chosen, posed, image_dir, model.extraction, progress)?;

    join(model, posed, &chosen, features, progress)
}

/// What follows extraction.
pub(crate) fn join(
    model: &mut MapModel,
    posed: &ColmapModel,
    images: &[&ColmapImage],
    features: Vec<Extracted>,
    progress: &dyn Progress,
) -> Result<(), MappingError> {
    let before = model.images.len() as u32;
    append_images(model, posed, images, features)?;
    let options = BuildOptions::default();
    let mut scene = Scene::of(model, &options);
    let focus: Vec<u32> = (before..model.images.len() as u32).collect();
    let edges = match_images(&scene, seeds_of_map(model), &focus, &options, progress);
    progress.start("Triangulating points", 1);
    grow(&mut scene, &edges.verified, &options);
    let points = scene.finish();
    progress.advance(1);
    progress.finish();
    model.points = points;
    model.link_keypoints();
    Ok(())
}

/// Takes the named images out of a map, with everything that came from them: points they saw are triangulated
/// again from the other images, or go when too few are left. All other points stay as they are, bit for bit.
///
/// # Errors
/// [`MappingError`]: an empty list, a name twice, or one that is not in the map. The map is then as it was.
pub fn remove(model: &mut MapModel, names: &[String]) -> Result<(), MappingError> {
    model.validate()?;
    if names.is_empty() {
        return Err(MappingError::EmptyList);
    }
    let mut leaving = BTreeSet::new();
    for name in names {
        let index = model.image_index(name).ok_or_else(|| MappingError::NotInMap { name: name.clone() })?;
        if !leaving.insert(index as u32) {
            return Err(MappingError::DuplicateName { name: name.clone() });
        }
    }

    let options = BuildOptions::default();
    let mut scene = Scene::of(model, &options);
    for point in &mut scene.points {
        let count = point.track.len();
        point.track.retain(|(image, _)| !leaving.contains(image));
        point.touched = point.track.len() < count;
    }
    scene.polish(&options, Fallback::Vanish);
    let points = scene.finish();
    model.points = points;

    let staying = (0..model.images.len() as u32).filter(|i| !leaving.contains(i));
    let new_index: BTreeMap<u32, u32> = staying.zip(0..).collect();
    let mut index = 0;
    model.images.retain(|_| {
        index += 1;
        !leaving.contains(&(index - 1))
    });
    for point in &mut model.points {
        for Observation { image, .. } in &mut point.track {
            *image = new_index[image];
        }
    }
    drop_unused_cameras(model);
    model.link_keypoints();
    Ok(())
}

fn drop_unused_cameras(model: &mut MapModel) {
    let used: BTreeSet<usize> = model.images.iter().map(|i| i.camera).collect();
    let new_index: BTreeMap<usize, usize> = used.iter().copied().zip(0..).collect();
    model.cameras = used.iter().map(|i| model.cameras[*i]).collect();
    for image in &mut model.images {
        image.camera = new_index[&image.camera];
    }
}

/// The points that each image of a map sees.
fn seeds_of_map(model: &MapModel) -> Seeds {
    let position = |id: veiloc_map::PointId| model.points[id.index()].position.coords;
    let of_image =
        |i: &veiloc_map::MapImage| i.point_of_keypoint.iter().flatten().map(|id| position(*id)).collect();
    model.images.iter().map(of_image).collect()
}
