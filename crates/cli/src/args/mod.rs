//! Arguments that several commands share, and settings: arguments from a file and from environment variables.

pub(crate) mod camera;
pub(crate) mod extraction_args;
pub(crate) mod extraction_error;
pub(crate) mod feature_args;
pub(crate) mod global_args;
pub(crate) mod json_args;
pub(crate) mod localization_args;
pub(crate) mod need;
pub(crate) mod progressive_args;
pub(crate) mod report_args;
pub mod settings;
