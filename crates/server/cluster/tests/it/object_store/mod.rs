//! Tests of `object_store`.

mod common;
mod hostile;
mod publishing;
