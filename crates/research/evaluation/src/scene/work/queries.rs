//! Stored results of finished queries: one line each, appended as soon as a query is finished.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use crate::results::QueryResult;
use serde::{Deserialize, Serialize};
use veiloc_map::MapFile;
use veiloc_mapping::build_cache::CacheKey;
use veiloc_mapping::mask_file;

use super::key::EvaluationKey as _;
use super::{QUERIES, Work, io};
use crate::error::EvalError;
use crate::pipeline::EvaluatedQuery;
use crate::scene::SceneEvaluation;

impl Work {
    /// The finished queries of this evaluation with this map.
    pub(in crate::scene) fn finished(
        &self,
        map: &MapFile,
        evaluation: &SceneEvaluation,
    ) -> Result<Finished, EvalError> {
        let mut base = CacheKey::new("query");
        base.file(map.path())?;
        base.behaviour(evaluation)?;
        base.debug(&evaluation.schemes);
        base.debug(&evaluation.estimators);
        base.debug(&evaluation.transmission);
        base.debug(&evaluation.gravity);
        base.debug(&evaluation.masks.is_some());
        base.debug(&evaluation.seed);
        if let Some(regions) = &evaluation.regions {
            base.debug(regions);
        }
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
        // An incomplete last line belongs to an interrupted query.
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

/// A line of the file.
#[derive(Serialize, Deserialize)]
struct Line {
    key: String,
    rows: Vec<QueryResult>,
}

/// Finished queries, and the file to which new ones are appended.
pub(in crate::scene) struct Finished {
    base: CacheKey,
    done: BTreeMap<String, Vec<QueryResult>>,
    path: PathBuf,
    file: Mutex<File>,
}

impl Finished {
    /// The stored result of a query, or the computed one, which is then stored.
    pub(in crate::scene) fn get_or(
        &self,
        query: &EvaluatedQuery,
        evaluation: &SceneEvaluation,
        compute: impl FnOnce() -> Result<Vec<QueryResult>, EvalError>,
    ) -> Result<Vec<QueryResult>, EvalError> {
        let mut key = self.base.clone();
        key.text(&query.name);
        key.text(&query.camera.to_string());
        key.pose(query.truth.as_ref());
        key.file(&query.path)?;
        if let Some(masks) = &evaluation.masks {
            key.file(&mask_file(masks, &query.name))?;
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
