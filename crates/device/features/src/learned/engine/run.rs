//! The interface of an engine.

use crate::learned::{Layer, Tensor};

/// An input of a network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Input {
    pub(crate) name: String,
    /// Its sides; `None` for an open side.
    pub(crate) sides: Vec<Option<usize>>,
}

/// A network in an engine.
pub(crate) trait Run: Send + Sync {
    /// Its inputs, in the file's order.
    fn inputs(&self) -> Vec<Input>;

    /// Names of its outputs, in the file's order.
    fn outputs(&self) -> Vec<String>;

    /// The file's metadata under a key.
    fn metadata(&self, key: &str) -> Option<String>;

    /// Results of these layers. `inputs` are in the file's order, not more than it has, each with as many numbers as
    /// its shape requires. The error is a text.
    fn run(&self, inputs: &[&Tensor], layers: &[Layer]) -> Result<Vec<Tensor>, String>;
}
