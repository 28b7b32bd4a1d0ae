//! Tests of `veiloc-obfuscation` from outside, one executable: linking is what costs.

mod border;
mod common;
mod decoys;
mod device_build;
mod hostile_profile;
mod image_global;
mod leaks;
mod lens;
mod masks;
mod pack;
mod rig;
mod seal;
mod session;
mod session_bytes;
mod wire_statistics;
