//! Tests of `build_cache`.

mod hands;
