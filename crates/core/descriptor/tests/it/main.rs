//! Tests of `veiloc-descriptor` from outside, one executable: linking is what costs.

mod oracle;
