//! Tests of `veiloc-features` from outside, one executable: linking is what costs.

mod bad_input;
mod blobs;
mod detector;
mod exif;
mod formats;
mod learned;
mod oracle;
mod photos;
mod reach;
mod threads;
