//! The stored map of an evaluation.

use std::fs;
use std::path::{Path, PathBuf};

use crate::results::MapSummary;
use veiloc_map::GravityDirection;
use veiloc_map::atomic_file::write_atomic;
use veiloc_mapping::build_cache::CacheKey;
use veiloc_mapping::image_file;

use super::key::EvaluationKey as _;
use super::{Work, io};
use crate::error::EvalError;
use crate::pipeline::SceneMap;
use crate::scene::SceneEvaluation;

impl Work {
    /// Path of the map of these images.
    pub(in crate::scene) fn map_of(
        &self,
        evaluation: &SceneEvaluation,
        names: &[String],
        down: Option<GravityDirection>,
    ) -> Result<StoredMap, EvalError> {
        let mut key = CacheKey::new("map");
        let build = &evaluation.build;
        key.text(&build.features);
        key.debug(&build.settings);
        key.debug(&build.device);
        key.debug(&evaluation.on_other_coordinate_frame);
        key.debug(&down.map(|down| down.in_world()));
        key.behaviour(evaluation)?;
        for point in evaluation.posed.points() {
            key.numbers(point.coords.iter().copied());
        }
        for name in names {
            key.text(name);
            if let Some(image) = evaluation.posed.get(name) {
                key.text(&image.camera.to_string());
                key.pose(Some(&image.cam_from_world));
                key.debug(&image.seen);
            }
            key.file(&image_file(&evaluation.images, name))?;
        }
        let name = key.hex();
        let path = |ending: &str| self.folder.join(format!("map-{}.{ending}", &name[..16]));
        Ok(StoredMap { map: path("vmap"), facts: path("json") })
    }
}

/// A stored map.
pub(in crate::scene) struct StoredMap {
    map: PathBuf,
    facts: PathBuf,
}

impl StoredMap {
    /// The map, if it was built and completely stored.
    pub(in crate::scene) fn open(&self) -> Option<Result<SceneMap, EvalError>> {
        let facts: MapSummary = serde_json::from_slice(&fs::read(&self.facts).ok()?).ok()?;
        self.map.is_file().then(|| SceneMap::opened(&self.map, facts))
    }

    pub(in crate::scene) fn path(&self) -> &Path {
        &self.map
    }

    /// Written last, so that a description without a complete map never exists.
    pub(in crate::scene) fn store(&self, facts: &MapSummary) -> Result<(), EvalError> {
        let bytes = serde_json::to_vec(facts).map_err(|e| io(&self.facts)(e.into()))?;
        write_atomic(&self.facts, &bytes).map_err(io(&self.facts))
    }
}
