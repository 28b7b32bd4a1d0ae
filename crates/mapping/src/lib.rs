//! Posed pictures to map: pairs, matching, tracks, triangulation.
