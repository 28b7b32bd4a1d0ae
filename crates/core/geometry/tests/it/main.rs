//! Integration tests of `veiloc-geometry`, one executable to save linking time.

mod cameras;
