//! Tests of `veiloc-geometry` from outside, one executable: linking is what costs.

mod cameras;
