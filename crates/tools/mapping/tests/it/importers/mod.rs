//! Tests of `importers`.

mod hloc;
mod poses;
