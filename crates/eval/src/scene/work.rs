//! What an evaluation keeps in a folder, so that an interruption loses no finished query and nothing is computed twice.
//!
//! Everything is found by a hash of what it was computed from: the bytes of the images, cameras and poses, the options, what
//! the extractor makes of an image, the version of this program. So a folder may serve several evaluations, and what no
//! longer fits is never taken for what does.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::{self, File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use veiloc_features::{Image, load_gray, mask_in};
use veiloc_geometry::CameraFromWorld;
use veiloc_map::MapFile;
use veiloc_obfuscation::ExtractError;
use veiloc_replacing::{TargetLock, write_whole};
use veiloc_results::{MapSummary, QueryResult};

use super::options::SceneEvaluation;
use crate::error::EvalError;
use crate::road::{AskedQuery, PlaceMap, Upright};

/// Results of queries, one line each.
const QUERIES: &str = "queries.jsonl";

/// The folder.
pub(super) struct Work {
    folder: PathBuf,
    /// Held: two runs would write into each other's lines.
    _lock: TargetLock,
}

impl Work {
    /// Made if it is not there.
    pub(super) fn in_folder(folder: &Path) -> Result<Self, EvalError> {
        fs::create_dir_all(folder).map_err(io(folder))?;
        let path = folder.join(QUERIES);
        let lock = TargetLock::try_acquire(&path).map_err(io(&path))?.ok_or_else(|| {
            EvalError::Options(format!(
                "{}: another run works in this folder; wait for it, or name another folder",
                folder.display()
            ))
        })?;
        Ok(Self { folder: folder.to_owned(), _lock: lock })
    }

    /// Where the map of this evaluation is, or will be.
    pub(super) fn map_of(
        &self,
        evaluation: &SceneEvaluation,
        upright: Option<&Upright>,
    ) -> Result<KeptMap, EvalError> {
        let mut key = Key::new("map");
        let build = &evaluation.build;
        key.text(&build.features);
        key.debug(&build.settings);
        key.debug(&build.device);
        key.debug(&upright.map(|upright| upright.down().in_world()));
        key.behaviour(evaluation)?;
        for point in evaluation.posed.points() {
            key.numbers(point.coords.iter().copied());
        }
        for name in &evaluation.map_list {
            key.text(name);
            if let Some(image) = evaluation.posed.get(name) {
                key.text(&image.camera.to_string());
                key.pose(Some(&image.cam_from_world));
                key.debug(&image.seen);
            }
            key.file(&evaluation.images.join(name))?;
        }
        let name = key.hex();
        let path = |ending: &str| self.folder.join(format!("map-{}.{ending}", &name[..16]));
        Ok(KeptMap { map: path("vmap"), facts: path("json") })
    }

    /// The finished queries of this evaluation in this map.
    pub(super) fn finished(
        &self,
        map: &MapFile,
        evaluation: &SceneEvaluation,
    ) -> Result<Finished, EvalError> {
        let mut base = Key::new("query");
        base.file(map.path())?;
        base.behaviour(evaluation)?;
        base.debug(&evaluation.schemes);
        base.debug(&evaluation.scores);
        base.debug(&evaluation.localize);
        base.debug(&evaluation.sending);
        base.debug(&evaluation.gravity_sd_deg);
        base.debug(&evaluation.masks.is_some());
        base.debug(&evaluation.seed);
        let path = self.folder.join(QUERIES);
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(io(&path))?;
        let mut text = String::new();
        file.read_to_string(&mut text).map_err(io(&path))?;
        // A line that an interruption cut short is of a query that is not finished.
        let whole = text.rfind('\n').map_or(0, |at| at + 1);
        file.set_len(whole as u64).map_err(io(&path))?;
        file.seek(SeekFrom::End(0)).map_err(io(&path))?;
        let mut done = BTreeMap::new();
        for (number, line) in (1..).zip(text[..whole].lines()) {
            let line: Line = serde_json::from_str(line).map_err(|e| {
                EvalError::DataSet(format!("{}:{number}: {e}; remove this line, or the file", path.display()))
            })?;
            done.insert(line.key, line.rows);
        }
        Ok(Finished { base, done, path, file: Mutex::new(file) })
    }
}

/// A map that is kept.
pub(super) struct KeptMap {
    map: PathBuf,
    facts: PathBuf,
}

impl KeptMap {
    /// The map, when it was built and remembered.
    pub(super) fn open(&self) -> Option<Result<PlaceMap, EvalError>> {
        let facts: MapSummary = serde_json::from_slice(&fs::read(&self.facts).ok()?).ok()?;
        self.map.is_file().then(|| PlaceMap::kept(&self.map, facts))
    }

    pub(super) fn path(&self) -> &Path {
        &self.map
    }

    /// Written last: facts without a whole map are never there.
    pub(super) fn remember(&self, facts: &MapSummary) -> Result<(), EvalError> {
        let bytes = serde_json::to_vec(facts).map_err(|e| io(&self.facts)(e.into()))?;
        write_whole(&self.facts, &bytes).map_err(io(&self.facts))
    }
}

/// A finished query.
#[derive(Serialize, Deserialize)]
struct Line {
    key: String,
    rows: Vec<QueryResult>,
}

/// Queries that are finished, and the file that they are added to.
pub(super) struct Finished {
    base: Key,
    done: BTreeMap<String, Vec<QueryResult>>,
    path: PathBuf,
    file: Mutex<File>,
}

impl Finished {
    /// The results of a query: those that are there, or computed, and then kept.
    pub(super) fn get_or(
        &self,
        query: &AskedQuery,
        evaluation: &SceneEvaluation,
        compute: impl FnOnce() -> Result<Vec<QueryResult>, EvalError>,
    ) -> Result<Vec<QueryResult>, EvalError> {
        let mut key = self.base.clone();
        key.text(&query.name);
        key.text(&query.camera.to_string());
        key.pose(query.truth.as_ref());
        key.file(&query.path)?;
        if let Some(masks) = &evaluation.masks {
            key.file(&mask_in(masks, Path::new(&query.name)))?;
        }
        let key = key.hex();
        if let Some(rows) = self.done.get(&key) {
            return Ok(rows.clone());
        }
        let line = Line { key, rows: compute()? };
        let mut text = serde_json::to_vec(&line).map_err(|e| io(&self.path)(e.into()))?;
        text.push(b'\n');
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.write_all(&text).and_then(|()| file.sync_data()).map_err(io(&self.path))?;
        Ok(line.rows)
    }
}

/// A hash of what something is computed from.
#[derive(Clone)]
struct Key(Sha256);

impl Key {
    fn new(what: &str) -> Self {
        let mut key = Self(Sha256::new());
        key.text(what);
        key.text(env!("CARGO_PKG_VERSION"));
        key
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.0.update((bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
    }

    fn text(&mut self, text: &str) {
        self.bytes(text.as_bytes());
    }

    fn debug(&mut self, value: &impl std::fmt::Debug) {
        self.text(&format!("{value:?}"));
    }

    fn numbers(&mut self, numbers: impl Iterator<Item = f64>) {
        numbers.for_each(|n| self.0.update(n.to_le_bytes()));
    }

    fn pose(&mut self, pose: Option<&CameraFromWorld>) {
        self.debug(&pose.is_some());
        if let Some(pose) = pose {
            self.numbers(pose.rotation().matrix().iter().copied());
            self.numbers(pose.translation().iter().copied());
        }
    }

    /// The content of a file; one that is not there is told apart, and named by whoever needs it.
    fn file(&mut self, path: &Path) -> Result<(), EvalError> {
        match fs::read(path) {
            Ok(bytes) => self.bytes(&bytes),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => self.text("no such file"),
            Err(e) => return Err(io(path)(e)),
        }
        Ok(())
    }

    /// What the extractor and the network of global descriptors make of an image: their names do not say which weights they
    /// were read with.
    fn behaviour(&mut self, evaluation: &SceneEvaluation) -> Result<(), EvalError> {
        let Some(name) = evaluation.map_list.first() else { return Ok(()) };
        let extractor = evaluation.build.extractors.named(&evaluation.build.features);
        let extractor = extractor.map_err(ExtractError::from)?;
        // An image that cannot be read is named by whoever builds the map.
        let Ok(gray) = load_gray(&evaluation.images.join(name)) else { return Ok(()) };
        let image = Image::from(gray);
        let features = extractor.extract(&image, 64).map_err(ExtractError::from)?;
        self.numbers(features.keypoints.iter().flat_map(|k| [k.pixel.u, k.pixel.v]));
        self.bytes(features.descriptors.as_bytes());
        if let Some(global) = &evaluation.build.global {
            self.debug(&global.describe(&image).map_err(ExtractError::from)?.as_codes());
        }
        Ok(())
    }

    fn hex(self) -> String {
        self.0.finalize().iter().fold(String::new(), |mut hex, byte| {
            write!(hex, "{byte:02x}").expect("a string takes all that is written to it");
            hex
        })
    }
}

fn io(path: &Path) -> impl Fn(std::io::Error) -> EvalError {
    move |source| EvalError::Io { path: path.to_owned(), source }
}
