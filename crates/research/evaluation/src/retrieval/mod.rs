//! `veiloc eval retrieval`: cost and recall of image retrieval as maps grow.
//!
//! A map of a million images is not available, and retrieval uses only an image's global descriptor. So the images of
//! a real map are extended by other images, and by as many synthetic descriptors as needed, composed block by block
//! from all of them.
//!
//! [`evaluate_retrieval`] computes the rows, [`table`] prints them.
#![forbid(unsafe_code)]

mod evaluate;
mod synthetic_descriptors;
mod table;

pub use evaluate::{RetrievalEvaluation, RetrievalRow, evaluate_retrieval};
pub use table::table;
