//! Tests of `privacy`.

mod real_sessions;
