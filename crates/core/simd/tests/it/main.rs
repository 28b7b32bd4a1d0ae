//! Tests of `veiloc-simd` from outside, one executable: linking is what costs.

mod pose;
mod sift;
