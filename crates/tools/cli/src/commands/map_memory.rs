//! Where a program that runs for long keeps the bytes of its maps.

use veiloc_map::MapMemory;

/// Where the bytes of maps are.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub(crate) enum Memory {
    Copied,
    Mapped,
}

impl From<Memory> for MapMemory {
    fn from(memory: Memory) -> Self {
        match memory {
            Memory::Copied => Self::Copied,
            Memory::Mapped => Self::Mapped,
        }
    }
}
