//! Tests of `inversion`.

mod evaluation;
mod training;
