//! Tests of `bus`.

mod laws;
mod servers;
