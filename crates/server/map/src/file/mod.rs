//! The map file: how a map lies on disk, how it is replaced safely, and how it is opened.

mod compressed;
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
mod without;
mod write;

pub use layout::FORMAT_VERSION;
pub use open::MapMemory;
pub use view::{ImageView, MapFile};
pub use without::{Evidence, MapView, PointWithout, Without};
pub use write::{MapLock, byte_count, write};

#[cfg(test)]
mod tests;
