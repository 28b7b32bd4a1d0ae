//! Tests of `problem_files`.

mod keypoints;
