//! What can be chosen in the training of any network.

use crate::AttackError;
use crate::KnownImage;
use crate::training::{Course, fingerprint};

use crate::learned::engine::encoder::Shape;

/// How a network is trained.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TrainingOptions {
    /// Steps of the optimizer. Default 3000.
    pub steps: usize,
    /// Images of a step. Default 2.
    pub images: usize,
    /// Keypoints drawn from each of them, so that no two steps see the same set. Default 512.
    pub keypoints: usize,
    /// Length of what stands for a keypoint within the network. Default 96.
    pub width: usize,
    /// Heads of an attention layer; they divide the width. Default 4.
    pub heads: usize,
    /// Attention layers. Default 2.
    pub layers: usize,
    /// Highest learning rate. Default 0.001.
    pub learning_rate: f64,
    /// Decay of weights, AdamW's. Default 0.01.
    pub weight_decay: f64,
    /// Share of entries dropped behind each half of a layer. Default 0.1.
    pub dropout: f64,
    /// Steps from one look at the validation images to the next. Default 250.
    pub validate_every: usize,
    /// Seed of weights and draws.
    pub seed: u64,
}

impl Default for TrainingOptions {
    fn default() -> Self {
        Self {
            steps: 3000,
            images: 2,
            keypoints: 512,
            width: 96,
            heads: 4,
            layers: 2,
            learning_rate: 1e-3,
            weight_decay: 0.01,
            dropout: 0.1,
            validate_every: 250,
            seed: 0,
        }
    }
}

/// Largest numbers that are taken for honest, in options and in files.
const MOST_INPUTS: usize = 1 << 13;
const MOST_WIDTH: usize = 1 << 11;
const MOST_LAYERS: usize = 64;

/// What is wrong with a whole number.
pub(crate) fn refuse(name: &'static str, value: usize, allowed: &'static str) -> AttackError {
    AttackError::refuse(name, value, allowed)
}

impl TrainingOptions {
    /// Everything but the shape.
    pub(crate) fn check(&self) -> Result<(), AttackError> {
        self.course().check()?;
        if self.keypoints < 2 {
            return Err(refuse("keypoints", self.keypoints, "at least 2"));
        }
        if !(0.0..0.95).contains(&self.dropout) {
            let allowed = "a share from 0 to below 0.95";
            return Err(AttackError::Option { name: "dropout", value: self.dropout, allowed });
        }
        Ok(())
    }

    /// What the loop of any training needs.
    pub(crate) fn course(&self) -> Course {
        Course {
            steps: self.steps,
            images: self.images,
            learning_rate: self.learning_rate,
            weight_decay: self.weight_decay,
            validate_every: self.validate_every,
            seed: self.seed,
        }
    }

    /// A number that is another one for other options or images.
    pub(crate) fn fingerprint(&self, what: &str, sets: [&[KnownImage]; 2]) -> u64 {
        fingerprint(|feed| {
            feed(what.as_bytes());
            feed(format!("{self:?}").as_bytes());
            for set in sets {
                feed(&(set.len() as u64).to_le_bytes());
                for image in set {
                    image.size().iter().for_each(|side| feed(&side.to_le_bytes()));
                    for p in image.keypoints() {
                        feed(&p.u.to_le_bytes());
                        feed(&p.v.to_le_bytes());
                    }
                }
            }
        })
    }
}

impl Shape {
    /// Whether such a network can be.
    pub(crate) fn check(&self) -> Result<(), AttackError> {
        if !(1..=MOST_INPUTS).contains(&self.inputs) {
            return Err(refuse("inputs", self.inputs, "a number from 1 to 8192"));
        }
        if !(1..=MOST_WIDTH).contains(&self.width) {
            return Err(refuse("width", self.width, "a number from 1 to 2048"));
        }
        if self.heads == 0 || !self.width.is_multiple_of(self.heads) {
            return Err(refuse("heads", self.heads, "a divisor of the width"));
        }
        if self.layers > MOST_LAYERS {
            return Err(refuse("layers", self.layers, "a number up to 64"));
        }
        Ok(())
    }
}
