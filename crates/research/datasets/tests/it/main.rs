//! Integration tests of `veiloc-datasets`; one executable, because linking dominates the build time.

mod formats;
mod problem_files;
