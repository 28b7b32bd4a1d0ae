//! Tests of `regions`.

mod any_bytes;
mod cutting;
