//! The map file: its format, and how it is written and opened.

mod compressed;
mod held_out;
mod layout;
mod open;
mod pack;
mod packed;
mod part;
mod region;
mod self_test;
mod uncertainty;
mod unpacked;
mod view;
mod write;

pub use held_out::{HeldOut, HeldOutPoint, MapView, PointEvidence};
pub use layout::FORMAT_VERSION;
pub use open::MapMemory;
pub use view::{ImageView, MapFile};
pub use write::{MapLock, byte_count, write};

#[cfg(test)]
mod tests;
