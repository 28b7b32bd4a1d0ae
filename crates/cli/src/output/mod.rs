//! Input and output that all commands share.
//!
//! - [`items`]: input files and folders, the errors of single ones, and the summary.
//! - [`lists`]: lists of images, with or without their cameras.
//! - [`targets`]: output files and folders, checked before a command begins.
//! - [`files`]: reading and writing whole files, never half-written.
//! - [`ui`]: everything that is printed; [`progress`]: progress of a stage of work; [`stages`]: progress of a library's
//!   work.
//! - [`position`]: positions with as many decimals as they justify.
//! - [`command_line`]: the arguments of the program, for documents that record them.
//! - [`exit`]: exit codes, and the classification of failures.

pub(crate) mod command_line;
pub(crate) mod exit;
pub(crate) mod files;
pub(crate) mod items;
pub(crate) mod lists;
pub(crate) mod position;
pub(crate) mod progress;
pub(crate) mod stages;
pub(crate) mod targets;
pub(crate) mod ui;
