//! Rendered places and geometric problems with ground truth.
