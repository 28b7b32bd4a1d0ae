//! Robust estimation: LO-RANSAC, scores, samplers, refinement and covariance.
