//! Tests of `calibration`.

mod synthetic;
