//! Tests of `auth`.

mod any_bytes;
