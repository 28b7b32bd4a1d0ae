//! Tests of `importers`.

mod hloc;
