//! One file a command: its arguments, and the few lines that hand them to the libraries.

pub(crate) mod demo;
mod device_args;
pub(crate) mod features;
pub(crate) mod listed;
pub(crate) mod localize;
pub(crate) mod map;
mod mask_args;
pub(crate) mod models;
pub(crate) mod query;
mod rig_file;
pub(crate) mod seal;
mod session_args;
pub(crate) mod token;
