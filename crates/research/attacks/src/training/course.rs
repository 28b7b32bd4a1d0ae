//! How long a network is trained, and how fast it learns.

use crate::AttackError;

/// The course of a training, whatever is learned.
#[derive(Debug, Clone, PartialEq)]
pub struct Course {
    /// Steps of the optimizer.
    pub steps: usize,
    /// Images of a step.
    pub images: usize,
    /// Highest learning rate.
    pub learning_rate: f64,
    /// Decay of weights, AdamW's.
    pub weight_decay: f64,
    /// Steps from one look at the validation images to the next.
    pub validate_every: usize,
    /// Seed of weights and draws.
    pub seed: u64,
}

impl Course {
    /// Whether there can be such a training.
    ///
    /// # Errors
    /// [`AttackError::Option`].
    pub fn check(&self) -> Result<(), AttackError> {
        for (name, value) in
            [("steps", self.steps), ("images", self.images), ("validate_every", self.validate_every)]
        {
            if value == 0 {
                return Err(AttackError::refuse(name, value, "at least 1"));
            }
        }
        let reals = [
            ("learning_rate", self.learning_rate, self.learning_rate > 0.0, "a number above 0"),
            ("weight_decay", self.weight_decay, self.weight_decay >= 0.0, "a number from 0"),
        ];
        for (name, value, good, allowed) in reals {
            if !good || !value.is_finite() {
                return Err(AttackError::Option { name, value, allowed });
            }
        }
        Ok(())
    }
}
