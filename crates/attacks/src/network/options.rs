//! What can be chosen in training.

use super::error::NetworkError;
use super::model::Shape;

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
    /// Nearest keypoints of the whole image that count as neighbours. Default 20.
    pub neighbours: usize,
    /// Length of an embedding. Default 96.
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
            neighbours: 20,
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
const MOST_DIMENSIONS: usize = 1 << 12;
const MOST_WIDTH: usize = 1 << 11;
const MOST_LAYERS: usize = 64;

impl TrainingOptions {
    /// The network's shape, everything checked.
    pub(super) fn shape(&self, dimension: usize) -> Result<Shape, NetworkError> {
        for (name, value) in [
            ("steps", self.steps),
            ("images", self.images),
            ("neighbours", self.neighbours),
            ("validate_every", self.validate_every),
        ] {
            if value == 0 {
                return Err(NetworkError::Option { name, value: 0.0, allowed: "at least 1" });
            }
        }
        if self.keypoints < 2 {
            let value = self.keypoints as f64;
            return Err(NetworkError::Option { name: "keypoints", value, allowed: "at least 2" });
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
        let shape = Shape { dimension, width: self.width, heads: self.heads, layers: self.layers };
        shape.check()?;
        Ok(shape)
    }
}

impl Shape {
    /// Whether such a network can be.
    pub(super) fn check(&self) -> Result<(), NetworkError> {
        let refuse =
            |name, value: usize, allowed| Err(NetworkError::Option { name, value: value as f64, allowed });
        if !(1..=MOST_DIMENSIONS).contains(&self.dimension) {
            return refuse("dimension", self.dimension, "a number from 1 to 4096");
        }
        if !(1..=MOST_WIDTH).contains(&self.width) {
            return refuse("width", self.width, "a number from 1 to 2048");
        }
        if self.heads == 0 || !self.width.is_multiple_of(self.heads) {
            return refuse("heads", self.heads, "a divisor of the width");
        }
        if self.layers > MOST_LAYERS {
            return refuse("layers", self.layers, "a number up to 64");
        }
        Ok(())
    }
}
