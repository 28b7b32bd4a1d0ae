//! Which result of a network is meant.

/// Which result of a network: an output by its number, or any layer by its name.
#[derive(Debug, Clone, PartialEq, Eq, serde::Deserialize)]
#[serde(untagged)]
pub enum Layer {
    /// Of the outputs that the file declares, this one; 0 is the first.
    Output(usize),
    /// The layer of this name.
    Named(String),
}

impl From<&str> for Layer {
    fn from(name: &str) -> Self {
        Self::Named(name.to_owned())
    }
}
