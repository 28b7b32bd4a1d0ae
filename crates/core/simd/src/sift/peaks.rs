//! Peaks of a stack of rows: differences of levels, and samples that no neighbour exceeds.

use super::lanes::{LANES, Lanes};
use crate::{Backend, dispatch};

/// Differences of neighbouring rows: `out[k] = rows[k + 1] - rows[k]`, sample by sample.
///
/// `rows` are `[N + 1]` rows of one length, a multiple of [`LANES`]; `out` is `[N, length]`.
///
/// # Panics
/// When lengths do not match.
// Not inlined, so that profiles and counters show it.
#[inline(never)]
pub fn differences<const ROWS: usize>(backend: Backend, rows: &[&[f32]; ROWS], out: &mut [f32]) {
    let length = rows[0].len();
    assert!(length.is_multiple_of(LANES) && rows.iter().all(|row| row.len() == length));
    assert!(out.len() == (ROWS - 1) * length, "{} differences of {ROWS} rows of {length}", out.len());
    dispatch::run(backend, Differences { rows, out });
}

struct Differences<'a, const ROWS: usize> {
    rows: &'a [&'a [f32]; ROWS],
    out: &'a mut [f32],
}

impl<const ROWS: usize> dispatch::Kernel for Differences<'_, ROWS> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { rows, out } = self;
        let length = rows[0].len();
        for at in (0..length).step_by(LANES) {
            // SAFETY: every row has `length` samples, a multiple of `LANES`, and `out` one row less.
            unsafe {
                let mut lower = Lanes::load(rows[0], at);
                for k in 1..ROWS {
                    let upper = Lanes::load(rows[k], at);
                    (upper - lower).store(out, (k - 1) * length + at);
                    lower = upper;
                }
            }
        }
    }
}

/// Columns of the middle row of `rows[1]` whose sample is farther than `threshold` from 0 and not exceeded by any of
/// its 26 neighbours: above `threshold` none is larger, below `-threshold` none smaller. Equal ones are all found.
///
/// `rows` are `[3 levels, 3 rows]` of one length, a multiple of [`LANES`]; only the first `width` samples are used, and
/// the first and last of those have no neighbours and are not found. Columns are appended in their order.
///
/// # Panics
/// When lengths do not match.
// Not inlined, so that profiles and counters show it.
#[inline(never)]
pub fn peaks(
    backend: Backend,
    rows: &[[&[f32]; 3]; 3],
    width: usize,
    threshold: f32,
    columns: &mut Vec<u32>,
) {
    let length = rows[1][1].len();
    assert!(length.is_multiple_of(LANES) && width <= length);
    assert!(rows.iter().flatten().all(|row| row.len() == length), "rows of one length");
    if width >= 3 {
        dispatch::run(backend, Peaks { rows, width, threshold, columns });
    }
}

struct Peaks<'a> {
    rows: &'a [[&'a [f32]; 3]; 3],
    width: usize,
    threshold: f32,
    columns: &'a mut Vec<u32>,
}

impl dispatch::Kernel for Peaks<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Peaks { rows, width, threshold, columns } = self;
        let length = rows[1][1].len();
        // The last block starts where it still has a neighbour on its right; the previous one may overlap it.
        let mut next = 1;
        while next < width - 1 {
            if length < LANES + 2 {
                break;
            }
            let at = next.min(length - LANES - 1);
            // SAFETY: `at >= 1` and `at + 1 + LANES <= length`, the length of every row.
            let hits = unsafe { hits(rows, at, threshold) };
            if let Some(hits) = hits {
                for (i, &hit) in hits.iter().enumerate() {
                    if hit != 0 && (next..width - 1).contains(&(at + i)) {
                        columns.push((at + i) as u32);
                    }
                }
            }
            next = at + LANES;
        }
        for at in next..width - 1 {
            if is_peak(rows, at, threshold) {
                columns.push(at as u32);
            }
        }
    }
}

/// The samples from `at` on that are peaks; `None` when none is.
///
/// # Safety
/// `at >= 1` and `at + 1 + LANES` is at most the length of every row.
#[inline(always)]
unsafe fn hits(rows: &[[&[f32]; 3]; 3], at: usize, threshold: f32) -> Option<[u32; LANES]> {
    // SAFETY: the caller guarantees the lengths.
    unsafe {
        let here = Lanes::load(rows[1][1], at);
        let mut far = 0;
        for i in 0..LANES {
            far |= u32::from(here.0[i].abs() > threshold);
        }
        if far == 0 {
            return None;
        }
        let (mut most, mut least) = (here, here);
        for level in rows {
            for row in level {
                for start in [at - 1, at, at + 1] {
                    let near = Lanes::load(row, start);
                    most = most.max(near);
                    least = least.min(near);
                }
            }
        }
        let mut hits = [0; LANES];
        let mut any = 0;
        for i in 0..LANES {
            let here = here.0[i];
            let hit = u32::from(here > threshold) & u32::from(here >= most.0[i])
                | u32::from(here < -threshold) & u32::from(here <= least.0[i]);
            hits[i] = hit;
            any |= hit;
        }
        (any != 0).then_some(hits)
    }
}

/// One sample, in rows too short for a vector.
fn is_peak(rows: &[[&[f32]; 3]; 3], at: usize, threshold: f32) -> bool {
    let here = rows[1][1][at];
    let near = || rows.iter().flatten().flat_map(|row| &row[at - 1..=at + 1]);
    (here > threshold && near().all(|&other| here >= other))
        || (here < -threshold && near().all(|&other| here <= other))
}
