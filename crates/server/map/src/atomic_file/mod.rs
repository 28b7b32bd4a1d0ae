//! Atomic replacement of files: one writer at a time ([`TargetLock`]), and after a crash the file is completely old
//! or completely new ([`replace_file`]; [`write_atomic`] if the old content need not be read first).
//!
//! ```
//! use veiloc_map::atomic_file::{Permissions, TargetLock, replace_file};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("count");
//! let lock = TargetLock::acquire(&path)?;
//! replace_file(&lock, Permissions::Preserve, |out| out.write_all(b"1"))?;
//! assert_eq!(std::fs::read(&path)?, b"1");
//! # Ok::<(), std::io::Error>(())
//! ```
#![forbid(unsafe_code)]

mod lock;
mod replace;

pub use lock::{TargetLock, followed};
pub use replace::{Permissions, replace_file, write_atomic};
