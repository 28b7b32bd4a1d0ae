//! Tests of `veiloc-mapping` from outside, one executable: linking is what costs.

mod build_cache;
mod calibration;
mod importers;
