//! Attacks on obfuscated queries: keypoint recovery and the guesses it must beat.
