//! Attacked data, adversaries, and the training data of query-only adversaries.

use std::path::PathBuf;

use super::super::AttackEvaluation;
use super::adversary::Adversary;
use crate::{EvalError, SceneEvaluation};

/// Inputs and options.
#[derive(Debug, Clone)]
pub struct AdversariesEvaluation {
    /// A scene whose map servers know, with the seed of its keypoints' dither; `None` for files alone.
    pub scene: Option<SceneEvaluation>,
    /// Keypoint files of images without a map, schemes, position networks of query-only adversaries, neighbours per keypoint and seed;
    /// the adversaries set what else they know.
    pub attack: AttackEvaluation,
    /// Adversaries, in the order of the table.
    pub adversaries: Vec<Adversary>,
    /// Keypoint files of other scenes, the training data of query-only adversaries; without them these are skipped.
    pub train: Vec<PathBuf>,
    /// A network that predicts neighbours, trained on other scenes.
    pub network: Option<PathBuf>,
    /// Number of attacked images of a scene or file, spread evenly; `None` for all.
    pub attacked: Option<usize>,
    /// Whether to run attacks that take seconds per image.
    pub slow_attacks: bool,
}

impl AdversariesEvaluation {
    pub(super) fn check(&self) -> Result<(), EvalError> {
        let refuse = |why: &str| Err(EvalError::Options(why.to_owned()));
        if self.scene.as_ref().is_none_or(|scene| scene.query_list.is_empty()) && self.attack.files.is_empty()
        {
            return refuse("nothing to attack: give a scene with queries, or keypoint files");
        }
        if !self.attack.schemes.iter().any(|s| s.hides_positions()) {
            return refuse("no scheme to attack: points are sent openly");
        }
        if self.adversaries.is_empty() {
            return refuse("no adversary is selected");
        }
        if self.attack.k == 0 || self.attacked == Some(0) {
            return refuse("the numbers of images and neighbours must be at least 1");
        }
        Ok(())
    }
}

/// All schemes, adversaries and images; the data must still be set.
impl Default for AdversariesEvaluation {
    fn default() -> Self {
        Self {
            scene: None,
            attack: AttackEvaluation::default(),
            adversaries: Adversary::ALL.to_vec(),
            train: Vec::new(),
            network: None,
            attacked: None,
            slow_attacks: true,
        }
    }
}
