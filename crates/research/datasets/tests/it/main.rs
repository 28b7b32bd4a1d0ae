//! Tests of `veiloc-datasets` from outside, one executable: linking is what costs.

mod formats;
mod problem_files;
