//! Internal: shared code of the micro-benchmarks in the `benches/` folder of this package and in `src/bin`.

pub mod samples;
