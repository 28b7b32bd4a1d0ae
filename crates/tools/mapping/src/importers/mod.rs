//! Readers and writers of other tools' files.

pub mod hloc;
