//! Queries of evaluations, with or without known poses.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::PosedImages;
use veiloc_mapping::{NameIndex, image_file};
use veiloc_protocol::FocalKnowledge;

use crate::error::EvalError;

/// A query image with a known pose.
#[derive(Debug, Clone)]
pub struct PosedQuery {
    /// Its name.
    pub name: String,
    /// Its file.
    pub path: PathBuf,
    /// Its camera.
    pub camera: Intrinsics,
    /// Its true pose.
    pub cam_from_world: CameraFromWorld,
}

/// A query image whose pose may be known.
#[derive(Debug, Clone)]
pub struct EvaluatedQuery {
    /// Its name.
    pub name: String,
    /// Its file.
    pub path: PathBuf,
    /// Its camera.
    pub camera: Intrinsics,
    /// How well its focal length is known.
    pub focal: FocalKnowledge,
    /// Its true pose; if `None`, errors are not measured.
    pub truth: Option<CameraFromWorld>,
}

impl From<PosedQuery> for EvaluatedQuery {
    fn from(query: PosedQuery) -> Self {
        let truth = Some(query.cam_from_world);
        let focal = FocalKnowledge::Calibrated;
        Self { name: query.name, path: query.path, camera: query.camera, focal, truth }
    }
}

/// The images with these names and their true poses.
///
/// # Errors
/// [`EvalError::DataSet`], naming the image that has none.
pub fn posed_queries(
    posed: &PosedImages,
    images: &Path,
    names: &[String],
) -> Result<Vec<PosedQuery>, EvalError> {
    let index = NameIndex::new(posed.images().iter().map(|image| (image.name.as_str(), image)));
    names
        .iter()
        .map(|name| {
            let image = index.get(name).ok_or_else(|| {
                EvalError::DataSet(format!(
                    "{name}: it is in the query list but has no pose; remove it from the list or add its pose"
                ))
            })?;
            Ok(PosedQuery {
                name: name.clone(),
                path: image_file(images, name),
                camera: image.camera,
                cam_from_world: image.cam_from_world,
            })
        })
        .collect()
}

/// The queries of a scene, none of which may be in its map; `cameras` replace those of the model.
///
/// # Errors
/// [`EvalError::DataSet`] for an image without a pose, or in both lists.
pub fn queries_of_scene(
    posed: &PosedImages,
    images: &Path,
    map_list: &[String],
    query_list: &[String],
    cameras: &BTreeMap<String, Intrinsics>,
) -> Result<Vec<PosedQuery>, EvalError> {
    let mut queries = posed_queries(posed, images, query_list)?;
    for query in &mut queries {
        query.camera = cameras.get(&query.name).copied().unwrap_or(query.camera);
    }
    if let Some(name) = query_list.iter().find(|q| map_list.contains(q)) {
        return Err(EvalError::DataSet(format!(
            "{name} is in the map list and in the query list; a query must not be in the map; remove it from one of the lists"
        )));
    }
    Ok(queries)
}
