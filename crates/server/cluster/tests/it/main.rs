//! Tests of `veiloc-cluster` from outside, one executable: linking is what costs.

mod common;
mod gateway;
mod object_store;
mod regions;
