//! The sealed query, the device profile, and their versioned wire formats.
