//! Tests of `args`.

mod any_bytes;
