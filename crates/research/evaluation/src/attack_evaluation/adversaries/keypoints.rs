//! Attacked keypoints, and the adversaries' data beside them.

use std::path::{Path, PathBuf};

use tempfile::TempDir;
use veiloc_datasets::problem_files::{KeypointImage, encode_keypoints, json_lines, read_keypoints};
use veiloc_features::Progress;

use super::super::spread::spread;
use crate::{EvalError, GeneratedProblem, SceneEvaluation, folder_name, make_problems};

/// All keypoints of a scene or a file, and the files that attacks read.
pub(super) struct AttackedKeypoints {
    /// Name of the scene or file.
    pub(super) data: String,
    /// Attacked images, spread evenly over all.
    pub(super) attacked: Vec<KeypointImage>,
    /// The other queries.
    pub(super) others: Vec<KeypointImage>,
    /// Knowledge from a map of the scene; `None` for images without a map.
    pub(super) scene: Option<SceneKnowledge>,
}

/// Knowledge of the operator of a map.
pub(super) struct SceneKnowledge {
    /// Images of the map, in the frames of their canonical cameras, as queries are.
    pub(super) map: Vec<KeypointImage>,
    /// Matches of all queries with the map, `problems.jsonl`.
    pub(super) problems: PathBuf,
    /// Matches of the map's images with the map, likewise.
    pub(super) map_problems: PathBuf,
    /// Keypoints of [`Self::map`] as a file.
    pub(super) map_file: PathBuf,
    _folder: TempDir,
}

impl AttackedKeypoints {
    /// Keypoints of a scene: of its queries, `attacked` of which are attacked (`None` for all), and of its map
    /// images.
    pub(super) fn of_scene(
        scene: &SceneEvaluation,
        attacked: Option<usize>,
        progress: &dyn Progress,
    ) -> Result<Self, EvalError> {
        let data = folder_name(&scene.images);
        let mut made: Vec<GeneratedProblem> = make_problems(scene, true, progress)?;
        let of_map = made.split_off(scene.query_list.len());
        let map_lines: Vec<String> = of_map.iter().map(|m| m.line.clone()).collect();
        let map: Vec<KeypointImage> = of_map.into_iter().map(|m| m.keypoints).collect();
        let temporary = |source| EvalError::Io { path: std::env::temp_dir(), source };
        let folder = tempfile::tempdir().map_err(temporary)?;
        let write = |name: &str, bytes: std::io::Result<Vec<u8>>| {
            let path = folder.path().join(name);
            bytes
                .and_then(|bytes| std::fs::write(&path, bytes))
                .map_err(|source| EvalError::Io { path: path.clone(), source })?;
            Ok::<PathBuf, EvalError>(path)
        };
        let lines: Vec<String> = made.iter().map(|m| m.line.clone()).collect();
        let scene = SceneKnowledge {
            problems: write("problems.jsonl", json_lines::encode(&lines, false))?,
            map_problems: write("map-problems.jsonl", json_lines::encode(&map_lines, false))?,
            map_file: write("map.jsonl", encode_keypoints(&map, false))?,
            map,
            _folder: folder,
        };
        let queries = made.into_iter().map(|m| m.keypoints).collect();
        let (attacked, others) = split(queries, attacked);
        Ok(Self { data, attacked, others, scene: Some(scene) })
    }

    /// Keypoints of a file without a map.
    pub(super) fn of_file(path: &Path, attacked: Option<usize>) -> Result<Self, EvalError> {
        let images = read_keypoints(path)?;
        let (attacked, others) = split(images, attacked);
        Ok(Self { data: json_lines::display_name(path), attacked, others, scene: None })
    }
}

/// Attacked images, spread evenly, and the others.
fn split(images: Vec<KeypointImage>, attacked: Option<usize>) -> (Vec<KeypointImage>, Vec<KeypointImage>) {
    let chosen = spread(images.len(), attacked);
    let (mut own, mut others) = (Vec::new(), Vec::new());
    for (i, image) in images.into_iter().enumerate() {
        if chosen.contains(&i) { &mut own } else { &mut others }.push(image);
    }
    (own, others)
}
