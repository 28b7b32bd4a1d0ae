//! Tests of `bus`.

mod laws;
pub(crate) mod servers;
