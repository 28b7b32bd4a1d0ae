//! Whole maps: synthetic scenes with known points, bad input, and (with `VEILOC_DATA`) real photographs.

mod input;
mod photographs;
mod synthetic;
