//! Integration tests of `veiloc-evaluation`; one executable, because linking dominates the build time.

mod attack_evaluation;
mod real_conditions;
mod real_regions;
mod real_scenes;
