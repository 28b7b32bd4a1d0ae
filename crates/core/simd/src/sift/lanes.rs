//! Sixteen numbers that are processed in parallel.
//!
//! Every operation is the IEEE 754 operation on each lane, and none are fused: equal bits on every machine.

use std::ops::{Add, Mul, Sub};

/// Numbers in a vector. Rows of samples have this length or a multiple.
pub const LANES: usize = 16;

/// One number per lane.
pub(super) type Lanes = Side<LANES>;

/// `N` numbers in parallel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Side<const N: usize>(pub(super) [f32; N]);

impl<const N: usize> Side<N> {
    /// The same number in every lane.
    #[inline(always)]
    pub(super) fn all(value: f32) -> Self {
        Self([value; N])
    }

    /// The numbers of `row` from `at` on.
    ///
    /// # Safety
    /// `at + N` is at most the length of `row`.
    #[inline(always)]
    pub(super) unsafe fn load(row: &[f32], at: usize) -> Self {
        debug_assert!(at + N <= row.len());
        // SAFETY: the caller guarantees the length, and an array of numbers may be read at any of their addresses.
        Self(unsafe { row.as_ptr().add(at).cast::<[f32; N]>().read() })
    }

    /// Writes into `row` from `at` on.
    ///
    /// # Safety
    /// `at + N` is at most the length of `row`.
    #[inline(always)]
    pub(super) unsafe fn store(self, row: &mut [f32], at: usize) {
        debug_assert!(at + N <= row.len());
        // SAFETY: as in `load`.
        unsafe { row.as_mut_ptr().add(at).cast::<[f32; N]>().write(self.0) };
    }

    /// The larger number of each lane; `self`, which is not NaN, where `other` is NaN.
    #[inline(always)]
    pub(super) fn max(self, other: Self) -> Self {
        // One instruction on each machine, with the same result for NaN; only the sign of a zero may differ.
        #[cfg(target_arch = "aarch64")]
        return self.by_four(other, |a, b| {
            // SAFETY: NEON belongs to every such machine.
            unsafe { std::arch::aarch64::vmaxnmq_f32(a, b) }
        });
        #[cfg(not(target_arch = "aarch64"))]
        {
            let mut out = self;
            for i in 0..N {
                out.0[i] = if other.0[i] > self.0[i] { other.0[i] } else { self.0[i] };
            }
            out
        }
    }

    /// The smaller number of each lane; `self`, which is not NaN, where `other` is NaN.
    #[inline(always)]
    pub(super) fn min(self, other: Self) -> Self {
        // As in `max`.
        #[cfg(target_arch = "aarch64")]
        return self.by_four(other, |a, b| {
            // SAFETY: as in `max`.
            unsafe { std::arch::aarch64::vminnmq_f32(a, b) }
        });
        #[cfg(not(target_arch = "aarch64"))]
        {
            let mut out = self;
            for i in 0..N {
                out.0[i] = if other.0[i] < self.0[i] { other.0[i] } else { self.0[i] };
            }
            out
        }
    }

    /// An operation on registers of four lanes. From a plain loop the compiler groups lanes of several vectors.
    #[cfg(target_arch = "aarch64")]
    #[inline(always)]
    fn by_four(
        self,
        other: Self,
        operation: impl Fn(
            std::arch::aarch64::float32x4_t,
            std::arch::aarch64::float32x4_t,
        ) -> std::arch::aarch64::float32x4_t,
    ) -> Self {
        use std::arch::aarch64::{vld1q_f32, vst1q_f32};
        const { assert!(N % 4 == 0) };
        let mut out = self;
        for k in (0..N).step_by(4) {
            // SAFETY: the arrays have `N` numbers, a multiple of four; NEON belongs to every such machine.
            unsafe {
                let (a, b) = (vld1q_f32(self.0.as_ptr().add(k)), vld1q_f32(other.0.as_ptr().add(k)));
                vst1q_f32(out.0.as_mut_ptr().add(k), operation(a, b));
            }
        }
        out
    }
}

/// Writes `even` and `odd` by turns into `row` from `at` on.
///
/// # Safety
/// `at + 2 LANES` is at most the length of `row`.
#[inline(always)]
pub(super) unsafe fn store_pairs(even: Lanes, odd: Lanes, row: &mut [f32], at: usize) {
    debug_assert!(at + 2 * LANES <= row.len());
    // From a plain loop the compiler makes sums of pairs instead, with each sample loaded twice.
    #[cfg(target_arch = "aarch64")]
    {
        use std::arch::aarch64::{float32x4x2_t, vld1q_f32, vst2q_f32};
        for k in (0..LANES).step_by(4) {
            // SAFETY: the caller guarantees the length; NEON belongs to every such machine.
            unsafe {
                let pair = float32x4x2_t(vld1q_f32(even.0.as_ptr().add(k)), vld1q_f32(odd.0.as_ptr().add(k)));
                vst2q_f32(row.as_mut_ptr().add(at + 2 * k), pair);
            }
        }
    }
    #[cfg(not(target_arch = "aarch64"))]
    for i in 0..LANES {
        // SAFETY: as above.
        unsafe {
            *row.get_unchecked_mut(at + 2 * i) = even.0[i];
            *row.get_unchecked_mut(at + 2 * i + 1) = odd.0[i];
        }
    }
}

macro_rules! lane_by_lane {
    ($($operator:ident $name:ident $sign:tt),*) => {$(
        impl<const N: usize> $operator for Side<N> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                let mut out = self;
                for i in 0..N {
                    out.0[i] = self.0[i] $sign other.0[i];
                }
                out
            }
        }
    )*};
}

lane_by_lane!(Add add +, Sub sub -, Mul mul *);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_stored_by_turns() {
        let number = |k: usize| (k as f32 - 20.0) / 7.0;
        let (even, odd) =
            (Side(std::array::from_fn(|k| number(2 * k))), Side(std::array::from_fn(|k| number(2 * k + 1))));
        let mut row = vec![-1.0; 2 * LANES + 8];
        // SAFETY: the row is 8 longer than the pairs.
        unsafe { store_pairs(even, odd, &mut row, 5) };
        for (at, found) in row.into_iter().enumerate() {
            let expected = if (5..5 + 2 * LANES).contains(&at) { number(at - 5) } else { -1.0 };
            assert_eq!(found.to_bits(), expected.to_bits(), "{at}");
        }
    }
}
