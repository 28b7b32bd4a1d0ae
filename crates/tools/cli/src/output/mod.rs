//! How every command talks with the person at the terminal.
//!
//! - [`items`]: files and folders that are given, the faults of single ones, and the summary of all.
//! - [`lists`]: lists of images, with or without their cameras.
//! - [`files`]: whole files in and out, never half-written.
//! - [`ui`]: all that is printed; [`progress`]: how far a stage of work has come; [`stages`]: the same of a library's work.
//! - [`command_line`]: what was typed, for documents that tell it.
//! - [`exit`]: how a command ends, and whose fault a failure is.

pub(crate) mod command_line;
pub(crate) mod exit;
pub(crate) mod files;
pub(crate) mod items;
pub(crate) mod lists;
pub(crate) mod progress;
pub(crate) mod stages;
pub(crate) mod ui;
