//! Tests of `privacy`.

mod real_sessions;
mod variants;
