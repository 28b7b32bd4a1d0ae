//! Tests of `veiloc-client` from outside, one executable: linking is what costs.

mod anchors;
mod common;
mod hostile;
mod progressive;
mod retries;
