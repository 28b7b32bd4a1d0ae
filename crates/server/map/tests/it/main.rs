//! Tests of `veiloc-map` from outside, one executable: linking is what costs.

mod cutting;
mod known_answers;
