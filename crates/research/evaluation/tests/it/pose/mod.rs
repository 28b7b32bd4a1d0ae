//! Tests of `pose`.

mod bound;
