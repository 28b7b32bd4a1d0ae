//! Every backend compared with naive loops over the raw rows.

use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::{Backend, MAX_DIM};

fn squared_distance(a: &[u8], b: &[u8]) -> u32 {
    a.iter().zip(b).map(|(&x, &y)| u32::from(x.abs_diff(y)).pow(2)).sum()
}

/// (distance, index) of all of `others`, nearest first; equally near ones by index.
fn ranked(one: &[u8], others: &[u8], dim: usize) -> Vec<(u32, u32)> {
    let mut all: Vec<_> =
        others.chunks_exact(dim).zip(0..).map(|(other, i)| (squared_distance(one, other), i)).collect();
    all.sort_unstable();
    all
}

/// Compares all backends, with queries in one call and in two, with sorted lists of all distances.
fn check(queries: &[u8], rows: &[u8], dim: usize) {
    let expected: Vec<_> = queries
        .chunks_exact(dim)
        .map(|query| {
            let ranked = ranked(query, rows, dim);
            let &(distance, index) = ranked.first()?;
            Some(BestTwo { index, distance, second: ranked.get(1).map(|r| r.0) })
        })
        .collect();
    let expected_columns: Vec<_> =
        rows.chunks_exact(dim).map(|row| ranked(row, queries, dim).first().map(|&(d, i)| (i, d))).collect();
    for backend in Backend::available() {
        let packed = PackedRows::new(backend, rows, dim);
        let name = backend.name();
        assert_eq!(best_two(queries, &packed), expected, "{name}");

        let mut columns = ColumnBest::new(&packed);
        assert_eq!(best_two_with_columns(queries, 0, &packed, &mut columns), expected, "{name}");
        let split = expected.len() / 3;
        let (head, tail) = queries.split_at(split * dim);
        let (mut first, mut last) = (ColumnBest::new(&packed), ColumnBest::new(&packed));
        best_two_with_columns(head, 0, &packed, &mut first);
        best_two_with_columns(tail, split as u32, &packed, &mut last);
        last.merge(&first);
        for (row, expected) in expected_columns.iter().enumerate() {
            assert_eq!(columns.nearest(row), *expected, "{name} row {row}");
            assert_eq!(last.nearest(row), *expected, "{name} row {row}, merged");
        }
        assert_eq!(columns.nearest(packed.len()), None);
    }
}

fn random(len: usize, values: std::ops::RangeInclusive<u8>, rng: &mut ChaCha8Rng) -> Vec<u8> {
    (0..len).map(|_| rng.random_range(values.clone())).collect()
}

#[test]
fn random_rows() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (n, m, dim) in
        [(1, 1, 128), (9, 1, 128), (1, 2, 128), (70, 1100, 128), (8, 32, 64), (33, 47, 1), (20, 40, 131)]
    {
        check(&random(n * dim, 0..=255, &mut rng), &random(m * dim, 0..=255, &mut rng), dim);
    }
}

#[test]
fn few_values_make_many_ties() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for dim in [1, 3, 4, 7] {
        check(&random(50 * dim, 0..=1, &mut rng), &random(600 * dim, 0..=1, &mut rng), dim);
    }
}

#[test]
fn extremes_do_not_overflow() {
    for dim in [1, 128, 1000, MAX_DIM] {
        let rows = [vec![255; dim], vec![0; dim], vec![128; dim]].concat();
        check(&rows, &rows, dim);
        check(&vec![0; dim], &vec![255; 2 * dim], dim);
        check(&vec![255; dim], &vec![0; 2 * dim], dim);
    }
}

#[test]
fn no_rows_or_no_queries() {
    check(&[], &[1, 2, 3, 4], 4);
    check(&[1, 2, 3, 4], &[], 4);
    check(&[], &[], 4);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_shape(n in 0_usize..40, m in 0_usize..80, dim in 1_usize..200, largest: u8, seed: u64) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        check(&random(n * dim, 0..=largest, &mut rng), &random(m * dim, 0..=largest, &mut rng), dim);
    }
}
