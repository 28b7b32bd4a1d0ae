//! The nearest neighbours of each descriptor, exact, in one pass over all pairs.

use rayon::prelude::*;
use veiloc_simd::{Backend, BestTwo, ColumnBest, PackedRows, best_two, best_two_with_columns};

use crate::{DescriptorKind, DescriptorView};

/// A descriptor of the database and its distance to the query descriptor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Neighbour {
    /// Its row in the database.
    pub index: u32,
    /// Squared Euclidean distance, in squared code units (RootSIFT codes are 512 times the unit vector).
    pub distance: u32,
}

/// The nearest descriptor, and the distance of the second nearest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TwoNearest {
    /// The nearest descriptor; of several equally near, the one with the lowest index.
    pub nearest: Neighbour,
    /// Squared distance of the second nearest; `None` when the database has only one row.
    pub second: Option<u32>,
}

impl From<BestTwo> for TwoNearest {
    fn from(best: BestTwo) -> Self {
        Self { nearest: Neighbour { index: best.index, distance: best.distance }, second: best.second }
    }
}

/// The two nearest database descriptors of each query descriptor, `[N_query]`.
///
/// `None` for every query when the database is empty or has descriptors of another kind, to which there is no distance.
/// Exact, and independent of the number of threads (rayon's current pool is used). Cost: about 0.5 ns per pair of 128
/// bytes and thread with AVX-512 VNNI (`cargo bench -p veiloc-benches --bench matching`).
pub fn two_nearest(query: DescriptorView<'_>, database: DescriptorView<'_>) -> Vec<Option<TwoNearest>> {
    SearchedRows::new(database).two_nearest(query)
}

/// A database that is searched more than once.
#[derive(Clone)]
pub struct SearchedRows {
    kind: DescriptorKind,
    packed: PackedRows,
}

impl SearchedRows {
    /// Copies the rows into the order of the search.
    pub fn new(rows: DescriptorView<'_>) -> Self {
        Self { kind: rows.kind(), packed: pack(rows) }
    }

    /// As [`two_nearest`].
    pub fn two_nearest(&self, query: DescriptorView<'_>) -> Vec<Option<TwoNearest>> {
        if query.kind() != self.kind {
            return vec![None; query.len()];
        }
        nearest_rows(query.as_bytes(), &self.packed)
    }
}

// Descriptors reveal the content of images (leak L8).
impl std::fmt::Debug for SearchedRows {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SearchedRows({})", self.kind)
    }
}

/// As [`two_nearest`], for rows that are packed.
pub(crate) fn nearest_rows(query: &[u8], database: &PackedRows) -> Vec<Option<TwoNearest>> {
    let dim = database.dim();
    let block = block_rows(query.len() / dim) * dim;
    let blocks: Vec<_> = query.par_chunks(block).map(|rows| best_two(rows, database)).collect();
    blocks.into_iter().flatten().map(|best| best.map(TwoNearest::from)).collect()
}

/// Nearest neighbours in both directions from one pass over the pairs.
pub(crate) struct BothWays {
    /// Per query, as [`two_nearest`].
    pub(crate) of_query: Vec<Option<TwoNearest>>,
    /// Per database row, the nearest query.
    pub(crate) of_database: ColumnBest,
}

/// As [`two_nearest`], with the nearest query of each database row from the same pass. Kinds must be equal.
pub(crate) fn both_ways(query: DescriptorView<'_>, database: DescriptorView<'_>) -> BothWays {
    let dim = query.kind().dim();
    let packed = pack(database);
    let rows_per_block = block_rows(query.len());
    let blocks: Vec<_> = query
        .as_bytes()
        .par_chunks(rows_per_block * dim)
        .enumerate()
        .map(|(block, rows)| {
            let mut columns = ColumnBest::new(&packed);
            let first = (block * rows_per_block) as u32;
            (best_two_with_columns(rows, first, &packed, &mut columns), columns)
        })
        .collect();
    let mut of_query = Vec::with_capacity(query.len());
    let mut of_database = ColumnBest::new(&packed);
    for (best, columns) in blocks {
        of_query.extend(best.into_iter().map(|best| best.map(TwoNearest::from)));
        of_database.merge(&columns);
    }
    BothWays { of_query, of_database }
}

pub(crate) fn pack(rows: DescriptorView<'_>) -> PackedRows {
    PackedRows::new(Backend::best(), rows.as_bytes(), rows.kind().dim())
}

/// Query rows per task. Depends on the number of threads; results do not, because queries are independent and merged
/// columns do not depend on the grouping of queries.
fn block_rows(queries: usize) -> usize {
    queries.div_ceil(4 * rayon::current_num_threads()).max(MIN_BLOCK_ROWS)
}

/// For fewer rows, parallelism costs more than it gains, and merging columns costs as much as searching.
const MIN_BLOCK_ROWS: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        DescriptorKind, Descriptors,
        test_data::{random_bytes, random_descriptors},
    };

    #[test]
    fn an_empty_database_has_no_neighbours() {
        let query = random_descriptors(3, 1);
        let none = Descriptors::empty(DescriptorKind::ROOT_SIFT);
        assert_eq!(two_nearest(query.view(), none.view()), [None; 3]);
        assert_eq!(two_nearest(none.view(), query.view()), []);
    }

    #[test]
    fn one_row_has_no_second() {
        let query = random_descriptors(1, 2);
        let found = two_nearest(query.view(), query.view());
        assert_eq!(found, [Some(TwoNearest { nearest: Neighbour { index: 0, distance: 0 }, second: None })]);
    }

    /// Squared distances of the numbers themselves, in simple loops over `i16`.
    fn signed_reference(query: &Descriptors, database: &Descriptors) -> Vec<Option<TwoNearest>> {
        let numbers = |rows: &Descriptors, i| rows.view().values(i).collect::<Vec<i16>>();
        let all: Vec<Vec<i16>> = (0..database.len()).map(|i| numbers(database, i)).collect();
        let nearest = |own: &[i16]| {
            let distance = |row: &Vec<i16>| -> u32 {
                row.iter().zip(own).map(|(a, b)| (i32::from(*a) - i32::from(*b)).pow(2) as u32).sum()
            };
            let mut sorted: Vec<(u32, u32)> = all.iter().map(distance).zip(0..).collect();
            sorted.sort_unstable();
            let (distance, index) = *sorted.first()?;
            let nearest = Neighbour { index, distance };
            Some(TwoNearest { nearest, second: sorted.get(1).map(|s| s.0) })
        };
        (0..query.len()).map(|i| nearest(&numbers(query, i))).collect()
    }

    #[test]
    fn signed_distances_equal_byte_distances() {
        for (dim, seed) in [(1, 1), (7, 2), (64, 3), (256, 4), (512, 5)] {
            let kind = DescriptorKind::new("own", dim, crate::Encoding::Signed, 64).expect("a kind");
            let (query, database) = (random_bytes(kind, 40, seed), random_bytes(kind, 90, seed + 10));
            let found = two_nearest(query.view(), database.view());
            assert_eq!(found, signed_reference(&query, &database), "{dim}");
        }
    }

    #[test]
    fn kinds_of_equal_length_do_not_match() {
        let own = DescriptorKind::new("own", 128, crate::Encoding::Unsigned, 512).expect("a kind");
        let query = random_bytes(own, 3, 1);
        assert_eq!(two_nearest(query.view(), random_descriptors(5, 1).view()), [None; 3]);
    }

    #[test]
    fn result_is_independent_of_the_thread_count() {
        let (query, database) = (random_descriptors(700, 3), random_descriptors(333, 4));
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let both = both_ways(query.view(), database.view());
                let columns: Vec<_> = (0..database.len()).map(|row| both.of_database.nearest(row)).collect();
                assert_eq!(both.of_query, two_nearest(query.view(), database.view()));
                (both.of_query, columns)
            })
        };
        let one = run(1);
        assert_eq!(one, run(2));
        assert_eq!(one, run(5));
    }
}
