//! Keypoints of a place's queries and map images, as attacks read them.

use std::path::PathBuf;

use tempfile::TempDir;
use veiloc_datasets::{KeypointImage, encode_keypoints, json_lines};
use veiloc_eval::{MadeProblem, ProblemSource, make_problems};
use veiloc_features::Progress;

use super::options::LayoutsEvaluation;
use crate::error::TradeoffError;
use crate::spread::spread;

/// All keypoints of the place, and the files that attacks read.
pub(super) struct Keypoints {
    /// Queries that are attacked, spread evenly over the list.
    pub(super) attacked: Vec<KeypointImage>,
    /// The other queries.
    pub(super) others: Vec<KeypointImage>,
    /// Images of the map, in the frames of their canonical cameras as queries are.
    pub(super) map: Vec<KeypointImage>,
    /// Matches of all queries with the map, `problems.jsonl`.
    pub(super) problems: PathBuf,
    /// Files of keypoints that teach the predictor.
    pub(super) train: Vec<PathBuf>,
    _folder: TempDir,
}

impl Keypoints {
    pub(super) fn of(evaluation: &LayoutsEvaluation, progress: &dyn Progress) -> Result<Self, TradeoffError> {
        let stress = &evaluation.stress;
        let (queries, map) = (&stress.query_list, &stress.map_list);
        let source = ProblemSource {
            posed: &stress.posed,
            images: &stress.images,
            map_list: map,
            query_list: &[queries.as_slice(), map.as_slice()].concat(),
            build: &stress.build,
            localize: &stress.localize,
            seed: stress.seed,
        };
        let mut made: Vec<MadeProblem> = make_problems(&source, progress)?;
        let map: Vec<KeypointImage> =
            made.split_off(queries.len()).into_iter().map(|m| m.keypoints).collect();
        let temporary = |source| TradeoffError::Io { path: std::env::temp_dir(), source };
        let folder = tempfile::tempdir().map_err(temporary)?;
        let write = |name: &str, bytes: std::io::Result<Vec<u8>>| {
            let path = folder.path().join(name);
            bytes
                .and_then(|bytes| std::fs::write(&path, bytes))
                .map_err(|source| TradeoffError::Io { path: path.clone(), source })?;
            Ok::<PathBuf, TradeoffError>(path)
        };
        let lines: Vec<String> = made.iter().map(|m| m.line.clone()).collect();
        let problems = write("problems.jsonl", json_lines::encode(&lines, false))?;
        let train = if evaluation.train.is_empty() {
            vec![write("map.jsonl", encode_keypoints(&map, false))?]
        } else {
            evaluation.train.clone()
        };
        let chosen = spread(made.len(), evaluation.attacked);
        let (mut attacked, mut others) = (Vec::new(), Vec::new());
        for (i, problem) in made.into_iter().enumerate() {
            if chosen.contains(&i) { &mut attacked } else { &mut others }.push(problem.keypoints);
        }
        Ok(Self { attacked, others, map, problems, train, _folder: folder })
    }

    /// All queries, the attacked first.
    pub(super) fn queries(&self) -> impl Iterator<Item = &KeypointImage> {
        self.attacked.iter().chain(&self.others)
    }
}
