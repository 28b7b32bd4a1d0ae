//! Replacing files whole: one writer of a file at a time ([`TargetLock`]), and whatever happens, the old file or the new one
//! is there ([`replace_file`]; [`write_whole`] where nobody reads the old one first).
//!
//! ```
//! use veiloc_map::atomic_file::{Readers, TargetLock, replace_file};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("count");
//! let lock = TargetLock::acquire(&path)?;
//! replace_file(&lock, Readers::AsBefore, |out| out.write_all(b"1"))?;
//! assert_eq!(std::fs::read(&path)?, b"1");
//! # Ok::<(), std::io::Error>(())
//! ```
#![forbid(unsafe_code)]

mod lock;
mod replace;

pub use lock::TargetLock;
pub use replace::{Readers, replace_file, write_whole};
