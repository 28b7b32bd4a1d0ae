//! Tests of `veiloc-ar` from outside, one executable: linking is what costs.

mod advice;
mod alignment;
mod axes;
mod burst;
mod lying_server;
mod room;
mod seal;
mod walk;
