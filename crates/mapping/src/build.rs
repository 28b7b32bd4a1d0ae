//! From posed images to a map.

use std::collections::BTreeSet;
use std::path::Path;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use veiloc_descriptor::{DescriptorView, Descriptors, Vocabulary};
use veiloc_geometry::nalgebra::Vector3;
use veiloc_map::colmap::{ColmapImage, ColmapModel};
use veiloc_map::{MapImage, MapModel};
use veiloc_query::Profile;

use crate::complete::grow;
use crate::error::MappingError;
use crate::extract::{Extracted, extract_all, select};
use crate::matching::{Edge, Edges, match_pairs};
use crate::options::BuildOptions;
use crate::pairs::{MIN_SEEDS, Seeds, pairs_by_pose, pairs_by_seeds};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::triangulation::{nearest_to_both_rays, widest_angle_deg};

/// Builds a map of the named images, whose poses and cameras the model `posed` holds.
///
/// Keypoints and points of `posed` are not taken over; its points only help to find pairs of images, where it has any.
///
/// # Errors
/// [`MappingError`]: an empty list, a name that is there twice or has no pose, an image that cannot be read or is not
/// of its camera's size, no keypoints at all, or nothing that could be triangulated.
pub fn build(
    posed: &ColmapModel,
    image_dir: &Path,
    names: &[String],
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Result<MapModel, MappingError> {
    options.check()?;
    let chosen = select(posed, names)?;
    let mut options = options.clone();
    options.min_track_length = options.min_track_length.min(chosen.len()).max(2);
    let options = &options;
    let features = extract_all(&chosen, posed, image_dir, options.extraction(), progress)?;
    let profile = profile(&features, options, progress)?;
    let mut model = MapModel::empty(profile, options.extraction());
    append_images(&mut model, posed, &chosen, features)?;

    let mut scene = Scene::of(&model, options);
    let focus: Vec<u32> = (0..chosen.len() as u32).collect();
    let edges = match_images(&scene, seeds_of_colmap(posed, &chosen), &focus, options, progress);
    progress.start("Triangulating points", 1);
    grow(&mut scene, &edges.verified, options);
    let points = scene.finish();
    progress.advance(1);
    progress.finish();
    if points.is_empty() {
        return Err(MappingError::NoPoints {
            images: chosen.len(),
            matches: edges.matches,
            verified: edges.verified.len(),
        });
    }
    model.points = points;
    sort_points(&mut model);
    model.link_keypoints();
    Ok(model)
}

/// In the order of their first observations, so that the points of one image lie together in the file.
pub(crate) fn sort_points(model: &mut MapModel) {
    model.points.sort_by(|a, b| a.track.cmp(&b.track));
}

/// The vocabulary learned from a sample of all descriptors, and the rest of what devices need.
pub(crate) fn profile(
    features: &[Extracted],
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Result<Profile, MappingError> {
    progress.start("Training the vocabulary", 1);
    let kind = features.first().map(|f| f.descriptors.kind()).ok_or(MappingError::EmptyList)?;
    let total: usize = features.iter().map(|f| f.descriptors.len()).sum();
    let words = options.vocabulary_words.min(total.max(1));
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let chosen = rand::seq::index::sample(&mut rng, total, total.min(words * SAMPLES_PER_WORD));
    let mut chosen = chosen.into_vec();
    chosen.sort_unstable();
    let mut sample = Descriptors::empty(kind);
    let (mut image, mut before) = (0, 0);
    for index in chosen {
        while index - before >= features[image].descriptors.len() {
            before += features[image].descriptors.len();
            image += 1;
        }
        sample.push(features[image].descriptors.row(index - before)).expect("a row of the same kind");
    }
    let vocabulary = Vocabulary::train(sample.view(), words, &mut rng)
        .map_err(|source| MappingError::NoKeypoints { images: features.len(), source })?;
    progress.advance(1);
    Ok(Profile::vlad(vocabulary).with_limits(options.device)?)
}

/// Adds images without points to a model; a camera that is already there is shared.
pub(crate) fn append_images(
    model: &mut MapModel,
    posed: &ColmapModel,
    images: &[&ColmapImage],
    features: Vec<Extracted>,
) -> Result<(), MappingError> {
    let global = model.profile.global_model();
    let of_image = || MappingError::GlobalOfImage { name: global.name().to_owned() };
    let globals = features.par_iter().map(|f| global.of_rows(f.descriptors.view()).ok_or_else(of_image));
    let globals: Vec<_> = globals.collect::<Result<_, _>>()?;
    for ((image, features), global) in images.iter().zip(features).zip(globals) {
        let camera = posed.camera_of(image);
        let known = model.cameras.iter().position(|c| c == camera);
        let camera = known.unwrap_or_else(|| {
            model.cameras.push(*camera);
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

/// Matches the images of `focus` with each other and with the rest, best edges first.
pub(crate) fn match_images(
    scene: &Scene<'_>,
    mut seeds: Seeds,
    focus: &[u32],
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Edges {
    let descriptors: &[DescriptorView<'_>] = &scene.descriptors;
    let unknown: Vec<u32> = focus.iter().copied().filter(|i| seeds[*i as usize].len() < MIN_SEEDS).collect();
    let first = pairs_by_pose(&scene.views, &unknown);
    progress.start("Matching first pairs", first.len());
    let mut edges = match_pairs(&first, &scene.views, descriptors, options.max_ratio, progress);
    add_seeds(scene, &edges.verified, &mut seeds);

    let known: BTreeSet<(u32, u32)> = first.into_iter().collect();
    let mut pairs = pairs_by_seeds(&scene.views, &seeds, focus, options.pairs_per_image);
    pairs.retain(|p| !known.contains(p));
    progress.start("Matching pairs", pairs.len());
    edges.extend(match_pairs(&pairs, &scene.views, descriptors, options.max_ratio, progress));
    edges.sort();
    edges
}

/// The points of a model that each image sees.
fn seeds_of_colmap(posed: &ColmapModel, images: &[&ColmapImage]) -> Seeds {
    let mut points: Vec<(u64, Vector3<f64>)> =
        posed.points().iter().map(|p| (p.id, p.position.coords)).collect();
    points.sort_by_key(|(id, _)| *id);
    let position = |id: u64| points.binary_search_by_key(&id, |(id, _)| *id).ok().map(|i| points[i].1);
    images.iter().map(|i| i.points2d.iter().filter_map(|p| position(p.point?)).collect()).collect()
}

/// Adds the points that matches place well enough to tell who else sees them.
fn add_seeds(scene: &Scene<'_>, edges: &[Edge], seeds: &mut Seeds) {
    for edge in edges {
        let (Some(a), Some(b)) = (scene.sight(edge.a), scene.sight(edge.b)) else { continue };
        let Some(point) = nearest_to_both_rays(&a, &b) else { continue };
        if widest_angle_deg(&[a, b], &point) >= MIN_SEED_ANGLE_DEG && a.agrees(&point) && b.agrees(&point) {
            seeds[edge.a.0 as usize].push(point);
            seeds[edge.b.0 as usize].push(point);
        }
    }
}

/// Descriptors a word is learned from.
const SAMPLES_PER_WORD: usize = 1000;
/// Seeds need a depth that is right within about a fifth, no more.
const MIN_SEED_ANGLE_DEG: f64 = 0.5;
