//! Tests of `veiloc-cluster` from outside, one executable: linking is what costs.

mod bus;
mod common;
mod object_store;
mod placement;
mod rates;
mod traces;
mod versions;
mod workers;
