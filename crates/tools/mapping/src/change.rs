//! Images join a map and leave it, without the map being built again.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use veiloc_descriptor::{DescriptorView, GlobalModel};
use veiloc_map::{MapImage, MapModel, Observation, PosedImage};
use veiloc_protocol::Profile;

use crate::build::{append_images, match_images};
use crate::complete::grow;
use crate::compress::refuse_compressed;
use crate::diagnose::explain;
use crate::error::MappingError;
use crate::extract::{Found, Makers, extract_all};
use crate::input::Input;
use crate::kept::{Extracted, Kept};
use crate::matching::Edges;
use crate::options::for_images;
use crate::pairs::Seeds;
use crate::progress::Progress;
use crate::report::BuildReport;
use crate::scene::{Fallback, Scene};
use crate::vocabulary::learn;

/// Adds posed images to a map, whose world is that of the poses.
///
/// Features are extracted as they were for the map, and matched with images that see the same. Points that gain
/// observations are refined, new points are added behind the old ones; all others, the vocabulary and the profile stay
/// as they are, bit for bit. An error leaves the map as it was.
///
/// # Errors
/// [`MappingError`] as for [`build`](crate::build), and when an image is already in the map.
pub fn add(
    model: &mut MapModel,
    input: &Input<'_>,
    progress: &dyn Progress,
) -> Result<BuildReport, MappingError> {
    model.validate()?;
    refuse_compressed(model)?;
    let extractors = input.extractors().cloned().unwrap_or_default();
    let extractor = extractors.of_kind(model.profile.descriptor_kind())?;
    let there: BTreeSet<&str> = model.images.iter().map(|i| i.name.as_str()).collect();
    let checked = input.check(|name| there.contains(name))?;
    let global = match model.profile.global_model() {
        GlobalModel::Vlad(_) => None,
        GlobalModel::Named(asked) => {
            let refused = || MappingError::GlobalOfImage { name: asked.name().to_owned() };
            Some(input.global().filter(|own| own.model() == *asked).ok_or_else(refused)?)
        }
    };
    let makers = Makers { extractor, global };
    let Found { images, features, skipped } =
        extract_all(checked, makers, model.settings.extraction, progress)?;
    let edges = join(model, &images, features, input.kept(), progress)?;
    let mut report = BuildReport::of(model, images.len(), skipped, edges.matches, edges.verified.len());
    explain(&mut report, model);
    Ok(report)
}

/// What follows extraction. An error leaves the map as it was.
pub(crate) fn join(
    model: &mut MapModel,
    images: &[&PosedImage],
    features: Vec<Extracted>,
    kept: Option<&dyn Kept>,
    progress: &dyn Progress,
) -> Result<Edges, MappingError> {
    let before = model.images.len() as u32;
    append_images(model, images, features)?;
    let settings = for_images(&model.settings, model.images.len());
    let mut scene = Scene::of(model, &settings);
    let focus: Vec<u32> = (before..model.images.len() as u32).collect();
    let edges = match_images(&scene, seeds_of_map(model), &focus, &settings, kept, progress).edges;
    progress.start("Triangulating points", 1);
    grow(&mut scene, &edges.verified, &settings);
    let points = scene.finish();
    progress.advance(1);
    progress.finish();
    model.points = points;
    model.self_test = None;
    model.link_keypoints();
    Ok(edges)
}

/// What becomes of the vocabulary when images leave a map.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Words {
    /// It stays, and with it the profile: queries sealed for the map still fit. Its words are averages of descriptors
    /// of many images; those of images that leave go on being part of them.
    #[default]
    Keep,
    /// It is learned again from the images that stay. The profile becomes another one: devices must fetch it, and
    /// queries sealed for the old one are refused.
    Retrain,
}

/// Takes the named images out of a map: their keypoints, descriptors and poses go. Points they saw are triangulated
/// again from the other images, or go when too few are left; all other points stay as they are, bit for bit.
///
/// What is left of the images then: under [`Words::Keep`] their share in the words of the vocabulary, under
/// [`Words::Retrain`] no share in any descriptor. Either way the other images' points are sought again from where they
/// stood, their keypoints stay joined as matches with the images that left may have joined them, and the old file may
/// live on in copies and backups.
///
/// # Errors
/// [`MappingError`]: an empty list, a name twice, names that are not in the map, or no image left to learn words from.
/// The map is then as it was.
pub fn remove(
    model: &mut MapModel,
    names: &[String],
    words: Words,
    progress: &dyn Progress,
) -> Result<(), MappingError> {
    model.validate()?;
    refuse_compressed(model)?;
    let leaving = leaving(model, names)?;
    let staying: Vec<usize> = (0..model.images.len()).filter(|i| !leaving.contains(&(*i as u32))).collect();
    let settings = model.settings;
    let profile = match words {
        Words::Keep => None,
        // Made of each image by itself: nothing was learned from those that leave.
        Words::Retrain if model.profile.vocabulary().is_none() => None,
        Words::Retrain if staying.is_empty() => return Err(MappingError::NothingLeft),
        Words::Retrain => {
            let views: Vec<DescriptorView<'_>> =
                staying.iter().map(|i| model.images[*i].descriptors.view()).collect();
            let vocabulary = learn(&views, &settings, progress)?;
            Some(Profile::vlad(vocabulary).with_limits(model.profile.limits())?)
        }
    };

    let mut scene = Scene::of(model, &settings);
    for point in &mut scene.points {
        let count = point.track.len();
        point.track.retain(|(image, _)| !leaving.contains(image));
        point.touched = point.track.len() < count;
    }
    scene.polish(&settings, Fallback::Vanish);
    let points = scene.finish();
    model.points = points;
    model.self_test = None;

    let new_index: BTreeMap<u32, u32> = staying.iter().map(|i| *i as u32).zip(0..).collect();
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
    if let Some(profile) = profile {
        model.images.par_iter_mut().for_each(|image| {
            if let Some(global) = profile.global_model().of_rows(image.descriptors.view()) {
                image.global = global;
            }
        });
        model.profile = profile;
    }
    progress.finish();
    Ok(())
}

/// Indices of the images with these names.
fn leaving(model: &MapModel, names: &[String]) -> Result<BTreeSet<u32>, MappingError> {
    if names.is_empty() {
        return Err(MappingError::EmptyList);
    }
    let index: BTreeMap<&str, u32> = model.images.iter().map(|i| i.name.as_str()).zip(0..).collect();
    let absent: Vec<String> = names.iter().filter(|n| !index.contains_key(n.as_str())).cloned().collect();
    if !absent.is_empty() {
        return Err(MappingError::NotInMap { names: absent });
    }
    let mut leaving = BTreeSet::new();
    match names.iter().find(|name| !leaving.insert(index[name.as_str()])) {
        Some(name) => Err(MappingError::DuplicateName { name: name.clone() }),
        None => Ok(leaving),
    }
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
    let of_image = |i: &MapImage| i.point_of_keypoint.iter().flatten().map(|id| position(*id)).collect();
    model.images.iter().map(of_image).collect()
}
