//! One file a command: its arguments, and the few lines that hand them to the libraries.

#[cfg(feature = "cluster")]
mod cluster_args;
pub(crate) mod demo;
mod device_args;
pub(crate) mod features;
pub(crate) mod listed;
pub(crate) mod localize;
pub(crate) mod map;
mod mask_args;
pub(crate) mod models;
mod page_args;
pub(crate) mod query;
mod rig_file;
pub(crate) mod seal;
pub(crate) mod serve;
mod session_args;
mod settled;
pub(crate) mod token;
mod voice;
#[cfg(feature = "cluster")]
pub(crate) mod worker;
