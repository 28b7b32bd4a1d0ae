//! Tests of `veiloc-pose` from outside, one executable: linking is what costs.

mod camera;
mod camera_priors;
mod duplicates;

mod estimate;
mod keypoints;
mod out_of_map;
mod partial;
mod real_problems;
mod rig;
mod rig_focal;
mod rivals;
mod shared_errors;
mod solvers;
mod support;
