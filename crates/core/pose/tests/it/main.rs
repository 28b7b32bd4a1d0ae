//! Tests of `veiloc-pose` from outside, one executable: linking is what costs.

mod camera;
mod elsewhere;
mod estimate;
mod keypoints;
mod partial;
mod real_problems;
mod rig;
mod rig_focal;
mod solvers;
mod support;
mod told;
