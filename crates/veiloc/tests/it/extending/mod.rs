//! The walk-throughs of `docs/guide/extending.md`: one small extension of each kind, added from outside the crates.

#[path = "../../../examples/rendered/mod.rs"]
mod rendered;

mod attack;
mod data_set;
mod feature;
mod global_descriptor;
mod scheme;
mod solver;
