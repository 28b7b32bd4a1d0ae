//! Learned global descriptors: one vector per image, computed by user-provided networks.

mod description;
mod learned;

pub use description::GlobalDescription;
pub use learned::LearnedGlobal;
