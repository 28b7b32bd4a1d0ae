//! Whole maps: synthetic scenes, then real photographs.
