//! Tests of `build_cache`.

mod distributed;
