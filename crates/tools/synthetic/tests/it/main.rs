//! Tests of `veiloc-synthetic` from outside, one executable: linking is what costs.

mod place;
mod problems;
