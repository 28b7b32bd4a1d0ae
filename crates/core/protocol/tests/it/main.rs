//! Tests of `veiloc-protocol` from outside, one executable: linking is what costs.

mod answer;
mod answer_document;
mod balance;
mod common;
mod content_anchors;
mod document;
mod hostile;
mod known_answers;
mod pack;
mod schema;
mod steps;
