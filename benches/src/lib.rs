//! Micro-benchmarks of the libraries, and what they share; see the `benches/` folder of this package and `src/bin`.

pub mod samples;
