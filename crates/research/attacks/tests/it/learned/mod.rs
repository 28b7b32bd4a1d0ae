//! Tests of `learned`.

mod neighbours;
mod positions;
