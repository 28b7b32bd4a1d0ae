//! Tests of whole maps: synthetic scenes with known points, bad input, and (with `VEILOC_DATA`) real images.

mod compress;
mod input;
mod real_images;
mod synthetic;
mod uncertainty;
