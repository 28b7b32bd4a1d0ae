//! Integration tests of `veiloc-attacks`; one executable, because linking dominates the build time.

mod geometry_recovery;
mod graph;
mod image_metrics;
mod learned;
mod multi_view;
mod predicted;
mod server_side;
