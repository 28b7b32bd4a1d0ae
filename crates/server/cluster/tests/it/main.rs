//! Tests of `veiloc-cluster` from outside, one executable: linking is what costs.

mod bus;
mod common;
mod machines;
mod object_store;
