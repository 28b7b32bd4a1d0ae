//! The commands that measure and attack: `veiloc eval`, `attack`, `audit`, `train` and `synth`. One file a command: its arguments, and
//! the few lines that hand them to the libraries.
#![forbid(unsafe_code)]

pub mod attack;
pub mod audit;
pub mod eval;
pub mod synth;
pub mod train;

use veiloc_arguments::{
    camera, extraction_args, faults, feature_args, global_args, json_args, localization_args,
    progressive_args, report_args,
};
// Every command talks by these: they go by the names of their files.
use veiloc_terminal::{exit, files, items, lists, stages, ui};
