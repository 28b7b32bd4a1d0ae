//! Readers and writers of other tools' files.

pub mod hloc;
pub mod lines;
pub mod poses;
pub mod ros_bag;
