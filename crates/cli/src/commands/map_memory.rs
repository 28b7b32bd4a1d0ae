//! Storage of map bytes in a long-running program.

use veiloc_map::MapMemory;

/// Storage of map bytes.
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
