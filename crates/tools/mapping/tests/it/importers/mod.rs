//! Tests of `importers`.

mod hloc;
mod odd_poses;
mod poses;
mod rig_cameras;
mod ros_bag;
