//! One dot product of two byte vectors.
//!
//! The loop is plain Rust; dispatch only selects the instructions for the compiler's vectorization.

use crate::backend::{Backend, Kind};

/// Sum of `a[i] * b[i]`, exact up to 66 000 components.
///
/// Both must have the same length; the rest of a longer one is ignored.
pub fn dot_u8(a: &[u8], b: &[u8]) -> u32 {
    dispatch(Backend::best(), a, b, DotU8)
}

/// Sum of `a[i] * b[i]`, exact for every length that fits in memory.
///
/// Both must have the same length; the rest of a longer one is ignored.
pub fn dot_i8(a: &[i8], b: &[i8]) -> i64 {
    dispatch(Backend::best(), a, b, DotI8)
}

/// A loop over two slices that is compiled once per instruction set.
trait Loop<T, R> {
    fn run(self, a: &[T], b: &[T]) -> R;
}

struct DotU8;

impl Loop<u8, u32> for DotU8 {
    #[inline(always)]
    fn run(self, a: &[u8], b: &[u8]) -> u32 {
        // i16 can represent every u8, and products of i16 pairs summed to i32 are one instruction everywhere.
        let product = |(&x, &y): (&u8, &u8)| i32::from(i16::from(x)) * i32::from(i16::from(y));
        a.iter().zip(b).map(product).fold(0_i32, i32::wrapping_add) as u32
    }
}

struct DotI8;

impl Loop<i8, i64> for DotI8 {
    #[inline(always)]
    fn run(self, a: &[i8], b: &[i8]) -> i64 {
        // 2^16 products of at most 2^14 fit i32.
        const CHUNK: usize = 1 << 16;
        let product = |(&x, &y): (&i8, &i8)| i32::from(i16::from(x)) * i32::from(i16::from(y));
        a.chunks(CHUNK)
            .zip(b.chunks(CHUNK))
            .map(|(a, b)| i64::from(a.iter().zip(b).map(product).sum::<i32>()))
            .sum()
    }
}

fn dispatch<T, R>(backend: Backend, a: &[T], b: &[T], body: impl Loop<T, R>) -> R {
    match backend.kind() {
        Kind::Portable => body.run(a, b),
        // SAFETY: the backend value proves that the CPU has these features.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx2 => unsafe { run_avx2(a, b, body) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512Vnni => unsafe { run_avx512(a, b, body) },
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2<T, R>(a: &[T], b: &[T], body: impl Loop<T, R>) -> R {
    body.run(a, b)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,avx512f,avx512bw,avx512vl,avx512vnni")]
fn run_avx512<T, R>(a: &[T], b: &[T], body: impl Loop<T, R>) -> R {
    body.run(a, b)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn check_u8(a: &[u8], b: &[u8]) {
        let expected: u64 = a.iter().zip(b).map(|(&x, &y)| u64::from(x) * u64::from(y)).sum();
        for backend in Backend::available() {
            assert_eq!(u64::from(dispatch(backend, a, b, DotU8)), expected, "{} {}", backend.name(), a.len());
        }
    }

    fn check_i8(a: &[i8], b: &[i8]) {
        let expected: i64 = a.iter().zip(b).map(|(&x, &y)| i64::from(x) * i64::from(y)).sum();
        for backend in Backend::available() {
            assert_eq!(dispatch(backend, a, b, DotI8), expected, "{} {}", backend.name(), a.len());
        }
    }

    #[test]
    fn extremes_do_not_overflow() {
        for len in [0, 1, 15, 63, 64, 65, 128, 1000, 66_000] {
            check_u8(&vec![255; len], &vec![255; len]);
            check_u8(&vec![0; len], &vec![255; len]);
        }
        for len in [0, 1, 127, 8192, 140_001, 300_000] {
            check_i8(&vec![-128; len], &vec![-128; len]);
            check_i8(&vec![127; len], &vec![-128; len]);
        }
    }

    proptest! {
        #[test]
        fn every_backend_agrees_with_wide_integers(
            pairs in prop::collection::vec(any::<(u8, u8)>(), 0..600),
        ) {
            let (a, b): (Vec<u8>, Vec<u8>) = pairs.into_iter().unzip();
            check_u8(&a, &b);
            let signed = |v: &[u8]| v.iter().map(|&x| x as i8).collect::<Vec<_>>();
            check_i8(&signed(&a), &signed(&b));
        }
    }
}
