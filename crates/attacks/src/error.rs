//! What can be wrong with the input of an attack.

/// Why an attack refused its input.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AttackError {
    /// There is not one neighbour list per observation.
    #[error("{observations} observations need as many neighbour lists, {lists} were given")]
    ListCount {
        /// Number of observations.
        observations: usize,
        /// Number of neighbour lists.
        lists: usize,
    },
    /// A neighbour list names an observation that does not exist.
    #[error("neighbour list {list} names observation {index}, but there are only {observations}")]
    UnknownNeighbour {
        /// Which list.
        list: usize,
        /// The index it names.
        index: u32,
        /// Number of observations.
        observations: usize,
    },
    /// The offsets of the lists do not start at 0, shrink, or do not end at the number of entries.
    #[error("neighbour list offsets must rise from 0 to the number of entries, {entries}")]
    Offsets {
        /// Number of entries.
        entries: usize,
    },
}
