//! What can be chosen in the training of any network.

use crate::engine::encoder::Shape;
use crate::error::NetworkError;

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
pub(crate) fn refuse(name: &'static str, value: usize, allowed: &'static str) -> NetworkError {
    NetworkError::Option { name, value: value as f64, allowed }
}

impl TrainingOptions {
    /// Everything but the shape.
    pub(crate) fn check(&self) -> Result<(), NetworkError> {
        for (name, value) in
            [("steps", self.steps), ("images", self.images), ("validate_every", self.validate_every)]
        {
            if value == 0 {
                return Err(refuse(name, value, "at least 1"));
            }
        }
        if self.keypoints < 2 {
            return Err(refuse("keypoints", self.keypoints, "at least 2"));
        }
        let reals = [
            ("learning_rate", self.learning_rate, self.learning_rate > 0.0, "a number above 0"),
            ("weight_decay", self.weight_decay, self.weight_decay >= 0.0, "a number from 0"),
            ("dropout", self.dropout, (0.0..0.95).contains(&self.dropout), "a share from 0 to below 0.95"),
        ];
        for (name, value, good, allowed) in reals {
            if !good || !value.is_finite() {
                return Err(NetworkError::Option { name, value, allowed });
            }
        }
        Ok(())
    }
}

impl Shape {
    /// Whether such a network can be.
    pub(crate) fn check(&self) -> Result<(), NetworkError> {
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
