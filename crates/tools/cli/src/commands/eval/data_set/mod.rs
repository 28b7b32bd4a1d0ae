//! `veiloc eval 7scenes`, `cambridge` and `aachen`: every scene of a published data set, one after another.

pub(super) mod aachen;
mod adversaries;
pub(super) mod cambridge;
mod options;
mod run;
pub(super) mod seven_scenes;
mod submission;

pub(super) use options::DataSetArgs;
pub(super) use run::{DataSet, evaluate};
