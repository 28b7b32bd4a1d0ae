//! Tests of `regions`.

mod any_bytes;
mod common;
mod cutting;
