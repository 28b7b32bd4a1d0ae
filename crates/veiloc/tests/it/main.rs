//! Integration tests of `veiloc`; one executable, because linking dominates the build time.

mod attack_own_images;
mod extending;
mod map_and_localize;
mod session;
