//! Tests of `veiloc-map` from outside, one executable: linking is what costs.

mod any_bytes;
mod regions;
