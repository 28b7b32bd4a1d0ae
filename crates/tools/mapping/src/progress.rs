//! How far a long job is: the same trait as for extraction.

pub use veiloc_features::Progress;
