//! Arguments that several commands share, each with its meaning and why the default; and settings, which are arguments
//! from files and environment variables.
#![forbid(unsafe_code)]

pub mod camera;
pub mod extraction_args;
pub mod faults;
pub mod feature_args;
pub mod global_args;
pub mod json_args;
pub mod localization_args;
pub mod progressive_args;
pub mod report_args;
pub mod settings;

// Every command talks by these: they go by the names of their files.
use veiloc_terminal::{exit, files, lists, ui};
