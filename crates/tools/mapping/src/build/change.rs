//! Adds images to a map and removes them, without rebuilding the map.

use std::collections::BTreeSet;

use rayon::prelude::*;
use veiloc_descriptor::{DescriptorView, GlobalModel};
use veiloc_map::{MapImage, MapModel};
use veiloc_protocol::Profile;

use crate::build::diagnose::explain;
use crate::build::extract::{ExtractionResult, ExtractorPair, extract_all};
use crate::build::report::{BuildReport, MapWarning};
use crate::build::vocabulary::learn;
use crate::build::{append_images, match_images};
use crate::compress::refuse_compressed;
use crate::coordinate_frames::{CoordinateFrameReport, MAX_TESTED, ReferenceMap, refused};
use crate::error::MappingError;
use crate::input::cache::BuildCache;
use crate::input::image_names::NameIndex;
use crate::input::options::for_images;
use crate::input::{Input, OnOtherCoordinateFrame};
use crate::progress::Progress;
use crate::triangulation::complete::grow;
use crate::triangulation::hold_out::drop_images;
use crate::triangulation::matching::Edges;
use crate::triangulation::pairs::Seeds;
use crate::triangulation::scene::Scene;

/// Adds posed images to a map; their poses must be in its world frame.
///
/// Features are extracted with the map's settings and matched with overlapping images. Points with new observations are
/// refined, and new points are appended; all other points, the vocabulary and the profile stay bit-identical. An error
/// leaves the map unchanged.
///
/// Before they join, the images are localized in the map: groups whose poses are in another coordinate frame are refused, or
/// transformed ([`Input::on_other_coordinate_frame`]). This needs memory for a copy of the map's file.
///
/// # Errors
/// [`MappingError`] as for [`build`](crate::build), if an image is already in the map, and
/// [`MappingError::OtherCoordinateFrame`].
pub fn add(
    model: &mut MapModel,
    input: &Input<'_>,
    progress: &dyn Progress,
) -> Result<BuildReport, MappingError> {
    model.validate()?;
    refuse_compressed(model)?;
    let extractors = input.extractors().cloned().unwrap_or_default();
    let extractor = extractors.of_kind(model.profile.descriptor_kind())?;
    let mapped = NameIndex::new(model.images.iter().map(|i| (i.name.as_str(), ())));
    let prefix = input.prefix();
    let checked = input.check(|name| mapped.get(&format!("{prefix}{name}")).is_some())?;
    let global = match model.profile.global_model() {
        GlobalModel::Vlad(_) => None,
        GlobalModel::Named(model_of_map) => {
            let refused = || MappingError::GlobalOfImage { name: model_of_map.name().to_owned() };
            Some(input.global().filter(|own| own.model() == *model_of_map).ok_or_else(refused)?)
        }
    };
    let extractor_pair = ExtractorPair { extractor, global };
    let ExtractionResult { images, features, skipped } =
        extract_all(checked, extractor_pair, model.settings.extraction, progress)?;
    let before = (model.images.len(), model.cameras.len());
    let reference = match input.other_coordinate_frame() {
        OnOtherCoordinateFrame::Accept => None,
        OnOtherCoordinateFrame::Refuse | OnOtherCoordinateFrame::Align => ReferenceMap::of(model)?,
    };
    append_images(model, &images, features)?;
    let frame = match reference.map(|reference| in_frame_of(&reference, model, before.0, input, progress)) {
        Some(Err(error)) => {
            model.images.truncate(before.0);
            model.cameras.truncate(before.1);
            return Err(error);
        }
        Some(Ok(frame)) => Some(frame),
        None => None,
    };
    let before = before.0;
    let edges = join(model, before, input.cache(), progress);
    model.images[before..].iter_mut().for_each(|image| image.name.insert_str(0, prefix));
    let mut report = BuildReport::of(model, images.len(), skipped, edges.matches, edges.verified.len());
    explain(&mut report, model);
    report.warnings.extend(frame.iter().flat_map(MapWarning::of_frame));
    report.coordinate_frame = frame;
    Ok(report)
}

/// Compares the poses of the images from `before` on with the map, and transforms them if requested.
fn in_frame_of(
    reference: &ReferenceMap,
    model: &mut MapModel,
    before: usize,
    input: &Input<'_>,
    progress: &dyn Progress,
) -> Result<CoordinateFrameReport, MappingError> {
    let images: Vec<usize> = (before..model.images.len()).collect();
    let (mut report, groups) = reference.compare(model, &images, MAX_TESTED, progress);
    if input.other_coordinate_frame() == OnOtherCoordinateFrame::Refuse && !groups.is_empty() {
        return Err(refused(groups));
    }
    let wrong = &report.disagreeing;
    if wrong.len() >= 2 && 2 * wrong.len() > report.localized {
        return Err(MappingError::PosesDisagree { names: wrong.clone(), localized: report.localized });
    }
    for group in &groups {
        group.align(model);
    }
    report.aligned = groups.into_iter().map(|group| group.coordinate_frame).collect();
    Ok(report)
}

/// Matches and triangulates the images from `before` on, which have no points yet.
pub(crate) fn join(
    model: &mut MapModel,
    before: usize,
    cache: Option<&dyn BuildCache>,
    progress: &dyn Progress,
) -> Edges {
    let settings = for_images(&model.settings, model.images.len());
    let mut scene = Scene::of(model, &settings);
    let focus: Vec<u32> = (before as u32..model.images.len() as u32).collect();
    let edges = match_images(&scene, seeds_of_map(model), &focus, &settings, cache, progress).edges;
    progress.start("Triangulating points", 1);
    grow(&mut scene, &edges.verified, &settings);
    let points = scene.finish();
    progress.advance(1);
    progress.finish();
    model.points = points;
    model.self_test = None;
    model.link_keypoints();
    edges
}

/// Treatment of the vocabulary when images are removed from a map.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum VocabularyUpdate {
    /// It stays, and so does the profile: queries sealed for the map remain valid. Its words are means of descriptors
    /// of many images, including the removed ones.
    #[default]
    Keep,
    /// It is trained again on the remaining images. The profile changes: devices must fetch it again, and queries
    /// sealed for the old one are refused.
    Retrain,
}

/// Removes the named images from a map with their keypoints, descriptors and poses. Points that they observe are
/// triangulated again from the other images, or removed if too few observations remain; all other points stay
/// bit-identical.
///
/// Remaining traces of the images: with [`VocabularyUpdate::Keep`] their share in the words of the vocabulary, with
/// [`VocabularyUpdate::Retrain`] no share in any descriptor. In both cases the refinement of other images' points
/// starts from their old positions, their keypoints remain merged even if matches with a removed image merged them, and
/// the old file may survive in copies and backups.
///
/// # Errors
/// [`MappingError`]: an empty list, a duplicate name, names that are not in the map, or no image left to train the
/// vocabulary on. The map is then unchanged.
pub fn remove(
    model: &mut MapModel,
    names: &[String],
    words: VocabularyUpdate,
    progress: &dyn Progress,
) -> Result<(), MappingError> {
    model.validate()?;
    refuse_compressed(model)?;
    let images_to_remove = images_to_remove(model, names)?;
    let staying: Vec<usize> =
        (0..model.images.len()).filter(|i| !images_to_remove.contains(&(*i as u32))).collect();
    let settings = model.settings;
    let profile = match words {
        VocabularyUpdate::Keep => None,
        // Computed for each image separately: the removed images had no influence.
        VocabularyUpdate::Retrain if model.profile.vocabulary().is_none() => None,
        VocabularyUpdate::Retrain if staying.is_empty() => return Err(MappingError::NothingLeft),
        VocabularyUpdate::Retrain => {
            let views: Vec<DescriptorView<'_>> =
                staying.iter().map(|i| model.images[*i].descriptors.view()).collect();
            let vocabulary = learn(&views, &settings, progress)?;
            Some(Profile::vlad(vocabulary).with_limits(model.profile.limits())?)
        }
    };

    drop_images(model, &images_to_remove);
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
fn images_to_remove(model: &MapModel, names: &[String]) -> Result<BTreeSet<u32>, MappingError> {
    if names.is_empty() {
        return Err(MappingError::EmptyList);
    }
    let index = NameIndex::new(model.images.iter().map(|i| i.name.as_str()).zip(0..));
    let (mut images_to_remove, mut absent) = (BTreeSet::new(), Vec::new());
    let mut duplicate = None;
    for name in names {
        match index.get(name) {
            None => absent.push(name.clone()),
            Some(image) if !images_to_remove.insert(image) => duplicate = duplicate.or(Some(name)),
            Some(_) => {}
        }
    }
    match duplicate {
        _ if !absent.is_empty() => Err(MappingError::NotInMap { names: absent }),
        Some(name) => Err(MappingError::DuplicateName { name: name.clone() }),
        None => Ok(images_to_remove),
    }
}

/// The points that each image of a map observes.
fn seeds_of_map(model: &MapModel) -> Seeds {
    let position = |id: veiloc_map::PointId| model.points[id.index()].position.coords;
    let of_image = |i: &MapImage| i.point_of_keypoint.iter().flatten().map(|id| position(*id)).collect();
    model.images.iter().map(of_image).collect()
}
