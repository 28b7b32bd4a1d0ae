//! The map of a scene, built for an evaluation.

use std::path::Path;
use std::time::Instant;

use tempfile::TempDir;
use veiloc_features::Progress;
use veiloc_map::{GravityDirection, MapFile, MapModel};
use veiloc_mapping::calibration::{SelfTestOptions, is_testable, self_test, self_test_compressed};
use veiloc_mapping::{BuildOptions, CompressOptions, Input, build, compress};

use crate::error::EvalError;
use crate::results::MapSummary;

/// A map that was built, written and opened again, as a server has it.
pub struct SceneMap {
    /// The map.
    pub file: MapFile,
    /// Facts about it.
    pub summary: MapSummary,
    /// Holds a temporary file until it is dropped.
    _folder: Option<TempDir>,
}

impl SceneMap {
    /// Builds the map with the down direction `down`; the file is written to `keep`. If `tested`, the map localizes
    /// its own images at the end, as with `veiloc map build`, so that answers have the covariances that they have in
    /// service.
    ///
    /// # Errors
    /// [`EvalError`] when data is missing or the map cannot be built, written or opened.
    pub fn build(
        input: &Input<'_>,
        options: &BuildOptions,
        tested: bool,
        keep: Option<&Path>,
        down: Option<GravityDirection>,
        progress: &dyn Progress,
    ) -> Result<Self, EvalError> {
        let started = Instant::now();
        let (mut model, _) = build(input, options, progress)?;
        model.down = down;
        let build_seconds = started.elapsed().as_secs_f64();
        if tested && is_testable(&model) {
            model.self_test = Some(self_test(&model, &SelfTestOptions::default(), progress)?);
        }
        Self::written(model, build_seconds, keep)
    }

    /// The same scene with a map smaller by the factor `times`, as `veiloc map compress` makes it.
    ///
    /// # Errors
    /// [`EvalError`] when it cannot be compressed that much, written or opened.
    pub(crate) fn compressed(
        self,
        times: f64,
        keep: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<Self, EvalError> {
        let started = Instant::now();
        let whole = self.file.to_model();
        let options = CompressOptions::new((self.summary.bytes as f64 / times) as u64);
        let mut small = compress(&whole, &options, progress)?;
        let seconds = self.summary.build_seconds + started.elapsed().as_secs_f64();
        if whole.self_test.is_some() {
            let test = self_test_compressed(&whole, &small, &SelfTestOptions::default(), progress)?;
            small.model.self_test = Some(test);
        }
        Self::written(small.model, seconds, keep)
    }

    fn written(model: MapModel, build_seconds: f64, keep: Option<&Path>) -> Result<Self, EvalError> {
        let folder =
            tempfile::tempdir().map_err(|source| EvalError::Io { path: std::env::temp_dir(), source })?;
        let path = keep.map_or_else(|| folder.path().join("place.vmap"), Path::to_owned);
        let folder = keep.is_none().then_some(folder);
        veiloc_map::write(&model, &path)?;
        drop(model);
        Ok(Self { _folder: folder, ..Self::given(&path, build_seconds)? })
    }

    /// Opens a map that took this time to build.
    ///
    /// # Errors
    /// [`EvalError`] when the file is not a map.
    pub(crate) fn given(path: &Path, build_seconds: f64) -> Result<Self, EvalError> {
        let file = MapFile::open(path)?;
        let bytes =
            std::fs::metadata(path).map_err(|source| EvalError::Io { path: path.to_owned(), source })?.len();
        let (images, points) = (file.image_count(), file.point_count());
        let summary = MapSummary { images, points, bytes, build_seconds, regions: None };
        Ok(Self { file, summary, _folder: None })
    }

    /// Opens a map that was built earlier.
    ///
    /// # Errors
    /// [`EvalError::Map`] when the file is not a map.
    pub(crate) fn opened(path: &Path, summary: MapSummary) -> Result<Self, EvalError> {
        Ok(Self { file: MapFile::open(path)?, summary, _folder: None })
    }

    /// Also copies its file to `keep`, if set.
    ///
    /// # Errors
    /// [`EvalError::Io`] when it cannot be written.
    pub(crate) fn copied_to(self, keep: Option<&Path>) -> Result<Self, EvalError> {
        if let Some(path) = keep {
            let copy = || veiloc_map::atomic_file::write_atomic(path, &std::fs::read(self.file.path())?);
            copy().map_err(|source| EvalError::Io { path: path.to_owned(), source })?;
        }
        Ok(self)
    }
}
