//! Tests of `veiloc-attacks` from outside, one executable: linking is what costs.

mod geometry_recovery;
mod graph;
mod image_metrics;
mod learned;
mod multi_view;
mod predicted;
mod server_side;
