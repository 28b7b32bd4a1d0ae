//! Tests of `veiloc-evaluation` from outside, one executable: linking is what costs.

mod audit;
mod inversion;
mod pose;
mod privacy;
mod real_regions;
mod real_scenes;
mod real_stress;
