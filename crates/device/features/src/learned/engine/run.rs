//! What an engine does with a network.

use crate::learned::{Layer, Tensor};

/// A network in an engine.
pub(crate) trait Run: Send + Sync {
    /// Sides of each input; `None` for a side that is open.
    fn inputs(&self) -> Vec<Vec<Option<usize>>>;

    /// How many inputs and outputs it has.
    fn ends(&self) -> [usize; 2];

    /// What the file says of itself under a key.
    fn metadata(&self, key: &str) -> Option<String>;

    /// Results of these layers on images of `[channels, height, width]`, no more than it has inputs; what went wrong in words.
    fn run(&self, images: &[([usize; 3], &[f32])], layers: &[Layer]) -> Result<Vec<Tensor>, String>;
}
