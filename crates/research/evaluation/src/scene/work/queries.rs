//! Stored results of finished queries: one line each, appended as soon as a query is finished.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use crate::results::QueryResult;
use serde::{Deserialize, Serialize};
use veiloc_mapping::build_cache::CacheKey;
use veiloc_mapping::mask_file;

use super::key::EvaluationKey as _;
use super::{QUERIES, Work, io};
use crate::error::EvalError;
use crate::pipeline::EvaluatedQuery;
use crate::scene::SceneEvaluation;
use crate::scene::case::{Case, Maps};

impl Work {
    /// The finished queries of this evaluation with these maps.
    pub(in crate::scene) fn finished(
        &self,
        maps: &Maps<'_>,
        evaluation: &SceneEvaluation,
    ) -> Result<Finished, EvalError> {
        let mut base = CacheKey::new("query");
        base.file(maps.whole.whole().path())?;
        base.behaviour(evaluation)?;
        base.debug(&evaluation.schemes);
        base.debug(&evaluation.estimators);
        base.debug(&evaluation.transmission);
        base.debug(&evaluation.from_truth);
        base.debug(&evaluation.masks.is_some());
        base.debug(&evaluation.retrieved);
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
        let mut sparse = CacheKey::new("sparse map");
        if let Some(map) = &maps.sparse {
            sparse.file(map.whole().path())?;
        }
        Ok(Finished { base, sparse: sparse.hex(), done, path, file: Mutex::new(file) })
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
    /// Hash of the map of few images.
    sparse: String,
    done: BTreeMap<String, Vec<QueryResult>>,
    path: PathBuf,
    file: Mutex<File>,
}

impl Finished {
    /// The stored results of a query under these conditions; those that are not stored are computed, and then stored.
    pub(in crate::scene) fn get_or(
        &self,
        query: &EvaluatedQuery,
        cases: &[&Case],
        evaluation: &SceneEvaluation,
        compute: impl FnOnce(&[&Case]) -> Result<Vec<Vec<QueryResult>>, EvalError>,
    ) -> Result<Vec<Vec<QueryResult>>, EvalError> {
        let mut base = self.base.clone();
        base.text(&query.name);
        base.text(&query.camera.to_string());
        base.text(query.focal.name());
        base.pose(query.truth.as_ref());
        base.file(&query.path)?;
        if let Some(masks) = &evaluation.masks {
            base.file(&mask_file(masks, &query.name))?;
        }
        let key_of = |case: &&Case| {
            let mut key = base.clone();
            key.text(&case.condition.to_string());
            if case.condition.sparse_map {
                key.text(&self.sparse);
            }
            key.hex()
        };
        let keys: Vec<String> = cases.iter().map(key_of).collect();
        let is_missing = |at: &usize| !self.done.contains_key(&keys[*at]);
        let missing: Vec<usize> = (0..cases.len()).filter(is_missing).collect();
        let computed = match &missing[..] {
            [] => Vec::new(),
            missing => compute(&missing.iter().map(|at| cases[*at]).collect::<Vec<_>>())?,
        };
        let mut text = Vec::new();
        let mut computed = missing
            .iter()
            .zip(computed)
            .map(|(at, rows)| Line { key: keys[*at].clone(), rows })
            .collect::<Vec<_>>();
        for line in &computed {
            serde_json::to_writer(&mut text, line).map_err(|e| io(&self.path)(e.into()))?;
            text.push(b'\n');
        }
        if !text.is_empty() {
            let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
            file.write_all(&text).and_then(|()| file.sync_data()).map_err(io(&self.path))?;
        }
        let rows = |key: &String| match self.done.get(key) {
            Some(rows) => rows.clone(),
            None => computed.remove(0).rows,
        };
        Ok(keys.iter().map(rows).collect())
    }
}
