//! `veiloc eval search`: what finding the images of a map that look like a query costs, and what it misses, as maps grow.
//!
//! A map of a million images is at nobody's hand, and retrieval sees nothing of an image but its global descriptor. So the
//! images of a real map are put among others: those of other images as they are, and as many more as are asked for, drawn
//! from all of them (drawn block by block).
//!
//! [`evaluate_search`] makes the rows, [`table`] shows them.
#![forbid(unsafe_code)]

mod draw;
mod evaluate;
mod table;

pub use evaluate::{SearchEvaluation, SearchRow, evaluate_search};
pub use table::table;
