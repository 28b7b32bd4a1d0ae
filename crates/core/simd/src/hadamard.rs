//! The Hadamard transform, in integers.

use crate::backend::Backend;
use crate::dispatch::{self, Kernel};

/// The Hadamard transform in place, without the normalizing factor: its own inverse up to a factor. Sums wrap on
/// overflow.
///
/// # Panics
/// When the number of values is not a power of two.
pub fn hadamard(values: &mut [i32]) {
    hadamard_on(Backend::best(), values);
}

fn hadamard_on(backend: Backend, values: &mut [i32]) {
    assert!(values.len().is_power_of_two(), "{} values", values.len());
    dispatch::run(backend, Hadamard(values));
}

struct Hadamard<'a>(&'a mut [i32]);

impl Kernel for Hadamard<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        // The passes may be done in any order. Those within sixteen neighbours are done on transposed tables of sixteen
        // by sixteen, so that they too are sums of whole vectors.
        let (tables, rest) = self.0.as_chunks_mut::<{ SIDE * SIDE }>();
        for table in tables {
            let mut transposed = transpose(table);
            passes(&mut transposed, SIDE);
            *table = transpose(&transposed);
            passes(table, SIDE);
        }
        passes(rest, 1);
        passes(self.0, SIDE * SIDE);
    }
}

/// The passes between partners at least this far apart.
#[inline(always)]
fn passes(values: &mut [i32], nearest: usize) {
    let mut apart = nearest;
    while apart < values.len() {
        for pair in values.chunks_exact_mut(2 * apart) {
            let (low, high) = pair.split_at_mut(apart);
            for (a, b) in low.iter_mut().zip(high) {
                (*a, *b) = (a.wrapping_add(*b), a.wrapping_sub(*b));
            }
        }
        apart *= 2;
    }
}

#[inline(always)]
fn transpose(table: &[i32; SIDE * SIDE]) -> [i32; SIDE * SIDE] {
    let mut transposed = [0; SIDE * SIDE];
    for row in 0..SIDE {
        for column in 0..SIDE {
            transposed[column * SIDE + row] = table[row * SIDE + column];
        }
    }
    transposed
}

/// Values in a vector of 512 bits.
const SIDE: usize = 16;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_backend_agrees_with_the_matrix() {
        for count in [1, 2, 4, 32, 128, 256, 512, 2048] {
            let values: Vec<i32> = (0..count).map(|i| (i * 7919 % 255) - 127).collect();
            // Entry (i, k) of the matrix is 1 for an even and -1 for an odd number of bits of i & k.
            let expected: Vec<i32> = (0..count)
                .map(|i| {
                    (0..count)
                        .map(|k| if (i & k).count_ones() % 2 == 0 { 1 } else { -1 } * values[k as usize])
                        .sum()
                })
                .collect();
            for backend in Backend::available() {
                let mut found = values.clone();
                hadamard_on(backend, &mut found);
                assert_eq!(found, expected, "{count} {}", backend.name());
            }
        }
    }

    #[test]
    fn transform_is_its_own_inverse() {
        let mut values: Vec<i32> = (0..4096).map(|i| i % 251 - 125).collect();
        let before = values.clone();
        hadamard(&mut values);
        hadamard(&mut values);
        assert!(values.iter().zip(&before).all(|(a, b)| *a == 4096 * b));
    }
}
