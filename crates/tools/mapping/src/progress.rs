//! Progress of a long job: the same trait as for extraction.

pub use veiloc_features::Progress;
