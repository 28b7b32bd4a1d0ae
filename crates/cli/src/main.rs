//! The `veiloc` binary.

fn main() {}
