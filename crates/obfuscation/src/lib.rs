//! The only door from keypoint to line: obfuscation schemes and sealing.
