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

    /// The larger number of each lane; there is no NaN.
    #[inline(always)]
    pub(super) fn max(self, other: Self) -> Self {
        let mut out = self;
        for i in 0..N {
            out.0[i] = if self.0[i] > other.0[i] { self.0[i] } else { other.0[i] };
        }
        out
    }

    /// The smaller number of each lane; there is no NaN.
    #[inline(always)]
    pub(super) fn min(self, other: Self) -> Self {
        let mut out = self;
        for i in 0..N {
            out.0[i] = if self.0[i] < other.0[i] { self.0[i] } else { other.0[i] };
        }
        out
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
