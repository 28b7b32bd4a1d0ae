//! Integration tests of `veiloc-simd`, one executable to save linking time.

mod pose;
mod sift;
