//! Builds a map from posed images; its files change, merge, import and finish maps.

pub(crate) mod change;
pub(crate) mod diagnose;
pub(crate) mod extract;
pub(crate) mod finish;
pub(crate) mod import;
pub(crate) mod merge;
pub(crate) mod prepare;
pub(crate) mod report;
pub(crate) mod vocabulary;

use std::collections::BTreeSet;

use rayon::prelude::*;
use veiloc_descriptor::{DescriptorView, GlobalModel};
use veiloc_map::{BuildSettings, MapImage, MapModel, PosedImage, PosedImages};
use veiloc_protocol::Profile;

use crate::build::diagnose::{diagnose, explain};
use crate::build::extract::{ExtractionResult, ExtractorPair, extract_all};
use crate::build::report::{BuildReport, MapWarning};
use crate::build::vocabulary::learn;
use crate::coordinate_frames::{CoordinateFrameReport, compare_groups, refused};
use crate::error::MappingError;
use crate::input::cache::{BuildCache, ExtractedFeatures};
use crate::input::options::{BuildOptions, for_images};
use crate::input::{Input, OnOtherCoordinateFrame};
use crate::progress::Progress;
use crate::triangulation::complete::grow;
use crate::triangulation::matching::{Edge, Edges, match_pairs};
use crate::triangulation::pairs::{MIN_SEEDS, Seeds, pairs_by_pose, pairs_by_seeds};
use crate::triangulation::scene::Scene;
use crate::triangulation::triangulate::{nearest_to_both_rays, widest_angle_deg};

/// Builds a map from posed images.
///
/// The points of the posed images are not used as map points; they only help to find image pairs. Without points, pairs
/// are found from the poses.
///
/// # Errors
/// [`MappingError`]: features of an unknown kind, no images, unusable images (all are named: duplicate, without pose or
/// without file before any computation; unreadable or not of their camera's size when they are read), no keypoints, or
/// no triangulated point, or a group of images whose poses are in another coordinate frame than the rest
/// ([`MappingError::OtherCoordinateFrame`], [`Input::on_other_coordinate_frame`]).
pub fn build(
    input: &Input<'_>,
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Result<(MapModel, BuildReport), MappingError> {
    options.settings.check()?;
    let extractors = input.extractors().unwrap_or(&options.extractors);
    let extractor = extractors.named(&options.features)?;
    let checked = input.check(|_| false)?;
    let extractor_pair = ExtractorPair { extractor, global: options.global.as_ref() };
    let ExtractionResult { images, features, skipped } =
        extract_all(checked, extractor_pair, options.settings.extraction, progress)?;
    let profile = profile(&features, options, progress)?;
    let mut model = MapModel::empty(profile, options.settings);
    append_images(&mut model, &images, features)?;

    let given_pairs = input.pairs_of(&images)?;
    let mut seeds = seeds_of(input.posed(), &images);
    let mut frame: Option<CoordinateFrameReport> = None;
    let MatchResult { edges, pairs } = loop {
        let matched =
            triangulate_all(&mut model, given_pairs.clone(), seeds.clone(), input.cache(), progress)?;
        if input.other_coordinate_frame() == OnOtherCoordinateFrame::Accept {
            break matched;
        }
        let (compared, groups) = compare_groups(&model, progress)?;
        frame = match (compared, frame.take()) {
            (Some(now), Some(before)) => Some(CoordinateFrameReport { aligned: before.aligned, ..now }),
            (now, before) => now.or(before),
        };
        let aligned = frame.as_ref().map_or(0, |report| report.aligned.len());
        if groups.is_empty() {
            break matched;
        }
        if input.other_coordinate_frame() == OnOtherCoordinateFrame::Refuse || aligned >= MAX_ALIGNED_GROUPS {
            return Err(refused(groups));
        }
        for group in groups {
            group.align(&mut model);
            // Points of the posed images are in their frame.
            group.images.iter().for_each(|image| seeds[*image].clear());
            frame.get_or_insert_default().aligned.push(group.coordinate_frame);
        }
    };
    let mut report = BuildReport::of(&model, images.len(), skipped, edges.matches, edges.verified.len());
    explain(&mut report, &model);
    report.warnings.extend(frame.iter().filter(|f| f.localized > 0).flat_map(MapWarning::of_frame));
    report.coordinate_frame = frame;
    let name = |index: u32| images[index as usize].name.clone();
    report.pairs = pairs.into_iter().map(|(a, b)| (name(a), name(b))).collect();
    Ok((model, report))
}

/// Matches the images of a model, and replaces its points.
fn triangulate_all(
    model: &mut MapModel,
    pairs: Option<Vec<(u32, u32)>>,
    seeds: Seeds,
    cache: Option<&dyn BuildCache>,
    progress: &dyn Progress,
) -> Result<MatchResult, MappingError> {
    model.points.clear();
    let settings = &for_images(&model.settings, model.images.len());
    let mut scene = Scene::of(model, settings);
    let focus: Vec<u32> = (0..model.images.len() as u32).collect();
    let matched = match pairs {
        Some(pairs) => match_given(&scene, pairs, settings, cache, progress),
        None => match_images(&scene, seeds, &focus, settings, cache, progress),
    };
    progress.start("Triangulating points", 1);
    grow(&mut scene, &matched.edges.verified, settings);
    let points = scene.finish();
    progress.advance(1);
    progress.finish();
    if points.is_empty() {
        return Err(MappingError::NoPoints {
            images: model.images.len(),
            matches: matched.edges.matches,
            verified: matched.edges.verified.len(),
            cause: diagnose(model).map(|cause| cause.to_string()),
        });
    }
    model.points = points;
    sort_points(model);
    model.link_keypoints();
    Ok(matched)
}

/// Sorts points by their first observations, so that the points of one image are adjacent in the file.
pub(crate) fn sort_points(model: &mut MapModel) {
    model.points.sort_by(|a, b| a.track.cmp(&b.track));
}

/// Returns the profile for devices, with the model of the global descriptor or with a vocabulary that is trained on a
/// sample of all descriptors.
pub(crate) fn profile(
    features: &[ExtractedFeatures],
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Result<Profile, MappingError> {
    let views: Vec<DescriptorView<'_>> = features.iter().map(|f| f.descriptors.view()).collect();
    if let Some(global) = &options.global {
        let kind = views.first().map(DescriptorView::kind).ok_or(MappingError::EmptyList)?;
        return Ok(Profile::new(kind, GlobalModel::Named(global.model()))?.with_limits(options.device)?);
    }
    let vocabulary = learn(&views, &options.settings, progress)?;
    Ok(Profile::vlad(vocabulary).with_limits(options.device)?)
}

/// Adds images without points to a model; equal cameras are shared.
pub(crate) fn append_images(
    model: &mut MapModel,
    images: &[&PosedImage],
    features: Vec<ExtractedFeatures>,
) -> Result<(), MappingError> {
    let global = model.profile.global_model();
    let of_image = || MappingError::GlobalOfImage { name: global.name().to_owned() };
    let globals = features.par_iter().map(|found| {
        let own = || found.global.clone().filter(|own| own.len() == global.global_len());
        global.of_rows(found.descriptors.view()).or_else(own).ok_or_else(of_image)
    });
    let globals: Vec<_> = globals.collect::<Result<_, _>>()?;
    for ((image, features), global) in images.iter().zip(features).zip(globals) {
        let known = model.cameras.iter().position(|c| *c == image.camera);
        let camera = known.unwrap_or_else(|| {
            model.cameras.push(image.camera);
            model.cameras.len() - 1
        });
        model.images.push(MapImage {
            name: image.name.clone(),
            camera,
            cam_from_world: image.cam_from_world,
            point_of_keypoint: vec![None; features.keypoints.len()],
            keypoints: features.keypoints,
            descriptors: features.descriptors,
            global,
        });
    }
    Ok(())
}

/// Result of matching.
pub(crate) struct MatchResult {
    /// Best first.
    pub(crate) edges: Edges,
    /// The matched image pairs.
    pub(crate) pairs: Vec<(u32, u32)>,
}

/// Returns the cache keys of the descriptors of each image, if a cache is given.
pub(crate) fn cache_keys(scene: &Scene<'_>, cache: Option<&dyn BuildCache>) -> Option<Vec<[u8; 32]>> {
    cache.map(|cache| scene.descriptors.par_iter().map(|own| cache.key(*own)).collect())
}

/// Matches exactly these pairs.
fn match_given(
    scene: &Scene<'_>,
    pairs: Vec<(u32, u32)>,
    settings: &BuildSettings,
    cache: Option<&dyn BuildCache>,
    progress: &dyn Progress,
) -> MatchResult {
    let keys = cache_keys(scene, cache);
    let cache = cache.zip(keys.as_deref());
    progress.start("Matching pairs", pairs.len());
    let mut edges =
        match_pairs(&pairs, &scene.views, &scene.descriptors, settings.max_ratio, cache, progress);
    edges.sort();
    MatchResult { edges, pairs }
}

/// Matches the images of `focus` with each other and with the rest; edges are sorted, best first.
pub(crate) fn match_images(
    scene: &Scene<'_>,
    mut seeds: Seeds,
    focus: &[u32],
    settings: &BuildSettings,
    cache: Option<&dyn BuildCache>,
    progress: &dyn Progress,
) -> MatchResult {
    let descriptors: &[DescriptorView<'_>] = &scene.descriptors;
    let first = first_pairs(scene, &seeds, focus);
    progress.start("Matching first pairs", first.len());
    let keys = cache_keys(scene, cache);
    let cache = cache.zip(keys.as_deref());
    let mut edges = match_pairs(&first, &scene.views, descriptors, settings.max_ratio, cache, progress);
    add_seeds(scene, &edges.verified, &mut seeds);

    let mut pairs = further_pairs(scene, &seeds, focus, settings, &first);
    progress.start("Matching pairs", pairs.len());
    edges.extend(match_pairs(&pairs, &scene.views, descriptors, settings.max_ratio, cache, progress));
    edges.sort();
    pairs.extend(first);
    pairs.sort_unstable();
    MatchResult { edges, pairs }
}

/// Pairs of images with too few seeds to judge their overlap.
pub(crate) fn first_pairs(scene: &Scene<'_>, seeds: &Seeds, focus: &[u32]) -> Vec<(u32, u32)> {
    let unknown: Vec<u32> = focus.iter().copied().filter(|i| seeds[*i as usize].len() < MIN_SEEDS).collect();
    pairs_by_pose(&scene.views, &unknown)
}

/// Pairs that share seeds, without those that were already matched.
pub(crate) fn further_pairs(
    scene: &Scene<'_>,
    seeds: &Seeds,
    focus: &[u32],
    settings: &BuildSettings,
    first: &[(u32, u32)],
) -> Vec<(u32, u32)> {
    let known: BTreeSet<&(u32, u32)> = first.iter().collect();
    let mut pairs = pairs_by_seeds(&scene.views, seeds, focus, settings.pairs_per_image as usize);
    pairs.retain(|p| !known.contains(p));
    pairs
}

/// Returns the known points that each image observes.
pub(crate) fn seeds_of(posed: &PosedImages, images: &[&PosedImage]) -> Seeds {
    let position = |id: &u32| posed.points()[*id as usize].coords;
    images.iter().map(|i| i.seen.iter().map(position).collect()).collect()
}

/// Adds the points that matches triangulate well enough to judge which other images see them.
pub(crate) fn add_seeds(scene: &Scene<'_>, edges: &[Edge], seeds: &mut Seeds) {
    for edge in edges {
        let (Some(a), Some(b)) = (scene.observation(edge.a), scene.observation(edge.b)) else { continue };
        let Some(point) = nearest_to_both_rays(&a, &b) else { continue };
        if widest_angle_deg(&[a, b], &point) >= MIN_SEED_ANGLE_DEG && a.agrees(&point) && b.agrees(&point) {
            seeds[edge.a.0 as usize].push(point);
            seeds[edge.b.0 as usize].push(point);
        }
    }
}

/// Groups whose poses are transformed, at most; more are not sessions of one place but inconsistent poses.
const MAX_ALIGNED_GROUPS: usize = 16;
/// Seeds need their depth only to about 20 %.
const MIN_SEED_ANGLE_DEG: f64 = 0.5;
