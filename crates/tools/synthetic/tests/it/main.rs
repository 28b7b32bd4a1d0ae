//! Tests of `veiloc-synthetic` from outside, one executable: linking is what costs.

mod problems;
mod scene;
