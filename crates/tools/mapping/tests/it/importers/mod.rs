//! Tests of `importers`.

mod hloc;
mod odd_poses;
mod poses;
