//! Sealed query and map to camera pose.
