//! Micro-benchmarks of the libraries; see the `benches/` folder of this package.
