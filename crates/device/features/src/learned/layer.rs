//! Selection of a network's result.

/// A result of a network: an output by its index, or any layer by its name.
#[derive(Debug, Clone, PartialEq, Eq, serde::Deserialize)]
#[serde(untagged)]
pub enum Layer {
    /// An output that the file declares; 0 is the first.
    Output(usize),
    /// The layer of this name.
    Named(String),
}

impl From<&str> for Layer {
    fn from(name: &str) -> Self {
        Self::Named(name.to_owned())
    }
}
