//! The map file: how a map lies on disk, how it is replaced safely, and how it is opened.

mod layout;
mod lock;
mod open;
mod replace;
mod view;
mod write;

pub use layout::FORMAT_VERSION;
pub use view::{ImageView, MapFile};
pub use write::{MapLock, write};

#[cfg(test)]
mod tests;
