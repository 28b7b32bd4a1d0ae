//! The map file: its format, and how it is written and opened.

mod compressed;
mod layout;
mod leave_one_out;
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

pub use layout::FORMAT_VERSION;
pub use leave_one_out::{LeaveOneOut, LeaveOneOutPoint, MapView, PointEvidence};
pub use open::MapMemory;
pub use view::{ImageView, MapFile};
pub use write::{MapLock, byte_count, write};

#[cfg(test)]
mod tests;
