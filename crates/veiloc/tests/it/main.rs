//! Tests of `veiloc` from outside, one executable: linking is what costs.

mod attack_own_images;
mod extending;
mod map_and_localize;
mod session;
