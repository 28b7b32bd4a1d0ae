//! Tests of `multi_view`.

mod frames;
mod sessions;
