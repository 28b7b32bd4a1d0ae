//! Attacked data, adversaries, and the training data of outsiders.

use std::path::PathBuf;

use veiloc_protocol::Scheme;

use super::adversary::Adversary;
use crate::{EvalError, SceneEvaluation};

/// Inputs and options.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct AdversariesEvaluation {
    /// A scene whose map servers know, with the seed of its keypoints' dither; `None` for files alone.
    pub scene: Option<SceneEvaluation>,
    /// Keypoint files of images without a map.
    pub files: Vec<PathBuf>,
    /// Schemes, in the order of the table. Schemes that send positions are skipped.
    pub schemes: Vec<Scheme>,
    /// Adversaries, in the order of the table.
    pub adversaries: Vec<Adversary>,
    /// Keypoint files of other scenes, the training data of outsiders; without them outsiders are skipped.
    pub train: Vec<PathBuf>,
    /// A network that predicts neighbours, trained on other scenes.
    pub network: Option<PathBuf>,
    /// Networks that predict positions from all rows, trained on other scenes, one per scheme.
    pub positions: Vec<PathBuf>,
    /// Number of attacked images of a scene or file, spread evenly; `None` for all.
    pub attacked: Option<usize>,
    /// Whether to run attacks that take seconds per image.
    pub slow_attacks: bool,
    /// Neighbours per keypoint.
    pub k: usize,
    /// Seed of every draw.
    pub seed: u64,
}

impl AdversariesEvaluation {
    /// All schemes that hide positions, all images; the data must still be set.
    pub fn new() -> Self {
        Self {
            scene: None,
            files: Vec::new(),
            schemes: Scheme::ALL.into_iter().filter(|s| s.hides_positions()).collect(),
            adversaries: Adversary::ALL.to_vec(),
            train: Vec::new(),
            network: None,
            positions: Vec::new(),
            attacked: None,
            slow_attacks: true,
            k: 20,
            seed: 0,
        }
    }

    pub(super) fn check(&self) -> Result<(), EvalError> {
        let refuse = |why: &str| Err(EvalError::Options(why.to_owned()));
        if self.scene.as_ref().is_none_or(|scene| scene.query_list.is_empty()) && self.files.is_empty() {
            return refuse("nothing to attack: give a scene with queries, or keypoint files");
        }
        if !self.schemes.iter().any(|s| s.hides_positions()) {
            return refuse("no scheme to attack: points are sent openly");
        }
        if self.adversaries.is_empty() {
            return refuse("no adversary is selected");
        }
        if self.k == 0 || self.attacked == Some(0) {
            return refuse("the numbers of images and neighbours must be at least 1");
        }
        Ok(())
    }
}

impl Default for AdversariesEvaluation {
    fn default() -> Self {
        Self::new()
    }
}
