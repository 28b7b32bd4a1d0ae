//! Tests of `learned`.

mod common;
mod engines;
mod globals;
mod models;
mod oracle;
mod sealing;
