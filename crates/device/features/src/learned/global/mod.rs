//! Learned global descriptors: one vector of a whole image, by networks that users bring.

mod description;
mod learned;

pub use description::GlobalDescription;
pub use learned::LearnedGlobal;
