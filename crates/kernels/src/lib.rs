//! The only room with unsafe code: vectorized kernels and memory-mapped files, behind safe functions.
