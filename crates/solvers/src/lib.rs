//! Minimal solvers for absolute pose and the polynomial roots they need.
