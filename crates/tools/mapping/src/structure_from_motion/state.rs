//! The work folder of structure from motion: database, models, and what they were computed from.
//!
//! ```text
//! work/database.db      features and matches of COLMAP
//! work/sparse/0, 1, …   models
//! work/images/          the images as COLMAP takes them, if some are panoramas or of another format (`prepared.rs`)
//! work/images.json      the images and options of the database
//! work/finished.json    written last: the images without a pose
//! ```

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use veiloc_map::atomic_file::write_atomic;

use super::images::are_frames;
use super::options::{MAX_EXHAUSTIVE, SfmMatching, SfmOptions};
use super::prepared::Prepared;
use super::unregistered::UnregisteredCause;
use crate::error::MappingError;

/// Fewer keypoints are a cause by themselves.
const FEW_KEYPOINTS: usize = 200;

/// Images without a pose, and the cause.
pub(super) type Causes = BTreeMap<String, UnregisteredCause>;

/// What to compute, and where.
pub(super) struct Task {
    pub(super) images: Prepared,
    /// The folder of the images, absolute.
    pub(super) folder: PathBuf,
    pub(super) is_sequential: bool,
    pub(super) seed: u64,
    work: PathBuf,
    /// Size and time of change of each file.
    files: Vec<Value>,
}

impl Task {
    pub(super) fn new(images: Prepared, work: &Path, options: &SfmOptions) -> Result<Self, MappingError> {
        let absolute = |path: &Path| std::path::absolute(path).map_err(MappingError::io(path));
        let (folder, work) = (absolute(&images.folder)?, absolute(work)?);
        let names = &images.names;
        let mut files = Vec::with_capacity(names.len());
        for name in names {
            let path = folder.join(name);
            let file = path.metadata().map_err(MappingError::io(&path))?;
            let changed =
                file.modified().ok().and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok());
            files.push(json!([name, file.len(), changed.map(|time| time.as_nanos() as u64)]));
        }
        let is_sequential = match options.matching {
            SfmMatching::Exhaustive => false,
            SfmMatching::Sequential => true,
            SfmMatching::Auto => names.len() > MAX_EXHAUSTIVE && are_frames(names),
        };
        Ok(Self { images, folder, is_sequential, seed: options.seed, work, files })
    }

    /// Images of the smallest model that COLMAP keeps: it begins again when a model stays smaller, which a first pair without
    /// parallax leads to.
    pub(super) fn min_model_size(&self) -> usize {
        (self.images.names.len() / 2).clamp(3, 10)
    }

    pub(super) fn database(&self) -> PathBuf {
        self.work.join("database.db")
    }

    pub(super) fn sparse(&self) -> PathBuf {
        self.work.join("sparse")
    }

    /// The models, by number.
    pub(super) fn models(&self) -> Vec<PathBuf> {
        crate::importers::poses::numbered_models(&self.sparse())
    }

    /// The images without a pose of an earlier run on the same files with the same options.
    pub(super) fn finished(&self) -> Option<Causes> {
        let read = |file: &str| -> Option<Value> {
            serde_json::from_str(&std::fs::read_to_string(self.work.join(file)).ok()?).ok()
        };
        if read("images.json")? != self.description() || self.models().is_empty() {
            return None;
        }
        let finished = read("finished.json")?;
        let causes = finished.get("unregistered")?.as_object()?;
        causes.iter().map(|(name, counts)| Some((name.clone(), cause_of(counts)?))).collect()
    }

    /// Makes the folder ready: keeps a database whose images are all among these, unchanged, and deletes another one.
    pub(super) fn prepare(&self) -> Result<(), MappingError> {
        std::fs::create_dir_all(&self.work).map_err(MappingError::io(&self.work))?;
        let path = self.work.join("images.json");
        let before: Option<Value> =
            std::fs::read_to_string(&path).ok().and_then(|text| serde_json::from_str(&text).ok());
        let same =
            |key: &str| before.as_ref().is_some_and(|before| before.get(key) == self.description().get(key));
        let files_of = |value: &Value| -> BTreeSet<String> {
            value.get("files").and_then(Value::as_array).into_iter().flatten().map(Value::to_string).collect()
        };
        let known = before.as_ref().map(files_of).unwrap_or_default();
        let is_usable = same("cameras") && same("rigs") && known.is_subset(&files_of(&self.description()));
        let remove = |path: &Path| match std::fs::remove_file(path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(MappingError::io(path)(error)),
            _ => Ok(()),
        };
        if !is_usable {
            for ending in ["db", "db-wal", "db-shm"] {
                remove(&self.database().with_extension(ending))?;
            }
        }
        remove(&self.work.join("finished.json"))?;
        let sparse = self.sparse();
        if sparse.is_dir() {
            // Only what is a model: the folder may be one of the user's.
            for model in self.models() {
                std::fs::remove_dir_all(&model).map_err(MappingError::io(&model))?;
            }
        }
        std::fs::create_dir_all(&sparse).map_err(MappingError::io(&sparse))?;
        write_atomic(&path, self.description().to_string().as_bytes()).map_err(MappingError::io(&path))
    }

    /// Records that all models are written.
    pub(super) fn finish(&self, causes: &Causes) -> Result<(), MappingError> {
        let counts = |cause: &UnregisteredCause| match cause {
            UnregisteredCause::FewKeypoints(keypoints) => json!([keypoints, 0]),
            UnregisteredCause::FewMatches { images } => json!([FEW_KEYPOINTS, images]),
            UnregisteredCause::NoMatches => json!([FEW_KEYPOINTS, 0]),
            UnregisteredCause::OtherModel | UnregisteredCause::Unknown => Value::Null,
        };
        let unregistered: serde_json::Map<String, Value> =
            causes.iter().map(|(name, cause)| (name.clone(), counts(cause))).collect();
        let path = self.work.join("finished.json");
        let text = json!({ "unregistered": unregistered }).to_string();
        write_atomic(&path, text.as_bytes()).map_err(MappingError::io(&path))
    }

    fn description(&self) -> Value {
        json!({
            "cameras": self.images.cameras.iter().map(|camera| &camera.names).collect::<Vec<_>>(),
            "rigs": self.images.rigs(),
            "sequential": self.is_sequential,
            "seed": self.seed,
            // What is done with the models; a change computes them again, not the database.
            "principal_point": "estimated",
            "files": self.files,
        })
    }
}

/// The cause by keypoints and verified pairs.
pub(super) fn cause(keypoints: usize, verified_pairs: usize) -> UnregisteredCause {
    match (keypoints, verified_pairs) {
        (keypoints, _) if keypoints < FEW_KEYPOINTS => UnregisteredCause::FewKeypoints(keypoints),
        (_, 0) => UnregisteredCause::NoMatches,
        (_, images) => UnregisteredCause::FewMatches { images },
    }
}

fn cause_of(counts: &Value) -> Option<UnregisteredCause> {
    if counts.is_null() {
        return Some(UnregisteredCause::Unknown);
    }
    let count = |at: usize| counts.get(at).and_then(Value::as_u64).map(|n| n as usize);
    Some(cause(count(0)?, count(1)?))
}
