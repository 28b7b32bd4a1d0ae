//! One file a command: its arguments, and the few lines that hand them to the libraries.

pub(crate) mod attack;
pub(crate) mod audit;
pub(crate) mod demo;
mod device_args;
pub(crate) mod eval;
mod localization_args;
pub(crate) mod localize;
pub(crate) mod map;
pub(crate) mod query;
mod rig_file;
pub(crate) mod seal;
pub(crate) mod serve;
mod session_args;

pub(crate) use veiloc_train as train;

use veiloc_terminal::json_args;
