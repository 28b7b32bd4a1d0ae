//! Tests of `veiloc-localization` from outside, one executable: linking is what costs.

mod common;
mod gravity;
mod other_places;
mod synthetic;
