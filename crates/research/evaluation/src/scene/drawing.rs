//! Data for drawings that documents do not hold: the sent lines, and which of them agree with the pose. Collected on
//! request, for a report on the user's own machine.

use std::path::PathBuf;

use veiloc_features::Progress;
use veiloc_geometry::{Intrinsics, Pixel};
use veiloc_localization::{Localization, localize};
use veiloc_map::MapFile;
use veiloc_mapping::image_file;
use veiloc_obfuscation::Extracted;
use veiloc_protocol::{Scheme, SealedQuery};

use super::options::SceneEvaluation;
use crate::error::EvalError;
use crate::pipeline::{image_of, seal_query};

/// One query with all its sent data.
#[derive(Debug, Clone)]
pub struct DrawnQuery {
    /// Its name.
    pub name: String,
    /// Its image.
    pub path: PathBuf,
    /// The camera it was taken with.
    pub camera: Intrinsics,
    /// Its keypoints, pixels of the image as it was taken.
    pub keypoints: Vec<Pixel>,
    /// Sent data under each scheme; schemes under which it cannot be sealed are left out.
    pub sent: Vec<DrawnScheme>,
}

/// A query under one scheme.
#[derive(Debug, Clone)]
pub struct DrawnScheme {
    /// The scheme.
    pub scheme: Scheme,
    /// The sent query.
    pub query: SealedQuery,
    /// Its pose and the inlier pairs; absent without a pose.
    pub found: Option<Localization>,
}

/// Seals queries again, exactly as [`evaluate_scene`](super::evaluate_scene) did, and localizes them whole with its
/// first score.
///
/// Random numbers depend on seed, query and scheme only, so these are the lines that were evaluated. Names that are
/// not queries of the evaluation are ignored.
///
/// # Errors
/// [`EvalError`] when an image cannot be read.
pub fn drawn_queries(
    evaluation: &SceneEvaluation,
    map: &MapFile,
    names: &[String],
    progress: &dyn Progress,
) -> Result<Vec<DrawnQuery>, EvalError> {
    progress.start("Drawing queries", names.len());
    let mut drawn = Vec::new();
    for name in names {
        if let Some(camera) = camera_of(evaluation, name) {
            drawn.push(drawn_query(evaluation, map, name, camera)?);
        }
        progress.advance(1);
    }
    progress.finish();
    Ok(drawn)
}

fn camera_of(evaluation: &SceneEvaluation, name: &str) -> Option<Intrinsics> {
    let posed = evaluation.query_list.iter().any(|query| query == name);
    let known =
        || evaluation.query_cameras.get(name).copied().or(evaluation.posed.get(name).map(|i| i.camera));
    let unposed = || evaluation.unposed.iter().find(|(query, _)| query == name).map(|(_, camera)| *camera);
    if posed { known() } else { unposed() }
}

fn drawn_query(
    evaluation: &SceneEvaluation,
    map: &MapFile,
    name: &str,
    camera: Intrinsics,
) -> Result<DrawnQuery, EvalError> {
    let path = image_file(&evaluation.images, name);
    let image = image_of(&path, evaluation.mask_of(name).as_deref())?;
    let extracted = evaluation.sealer(map.profile(), Scheme::default())?.extract(image, camera)?;
    let (features, camera) = (extracted.features(), extracted.camera().intrinsics);
    let mut sent = Vec::new();
    for scheme in &evaluation.schemes {
        let sealer = evaluation.sealer(map.profile(), *scheme)?;
        let sealed = seal_query(&sealer, Extracted::new(features.clone(), camera), name, evaluation.seed);
        let query = sealed.ok().and_then(|sealed| SealedQuery::decode(&sealed.bytes).ok());
        let Some(query) = query else { continue };
        let found = localize(&query, map, evaluation.localize()).ok();
        sent.push(DrawnScheme { scheme: *scheme, query, found });
    }
    let keypoints = features.keypoints.iter().map(|keypoint| keypoint.pixel).collect();
    Ok(DrawnQuery { name: name.to_owned(), path, camera, keypoints, sent })
}
