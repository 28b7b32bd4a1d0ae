//! Integration tests of `veiloc-evaluation`; one executable, because linking dominates the build time.

mod audit;
mod inversion;
mod privacy;
mod real_conditions;
mod real_regions;
mod real_scenes;
