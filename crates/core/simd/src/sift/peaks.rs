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
/// its 26 neighbours: above `threshold` none is larger, below `-threshold` none smaller. Equal ones are all found, and
/// NaN exceeds nothing.
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

/// Columns that are searched at once: each is compared once, and not once for each of its neighbours.
const CHUNK: usize = 4 * LANES;

/// One number for each column of a chunk, between one vector that is not used on each side.
type OfColumns = [f32; CHUNK + 2 * LANES];

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
        let chunk = CHUNK.min(length);
        let (mut most, mut least) = ([0.0; CHUNK + 2 * LANES], [0.0; CHUNK + 2 * LANES]);
        let mut next = 1;
        while next < width - 1 {
            // The first and last columns of a chunk are only neighbours; the last chunk may overlap the previous one.
            let first = (next - 1).min(length - chunk);
            let end = (first + chunk - 1).min(width - 1);
            // SAFETY: `first + chunk` is at most the length of every row, and both are multiples of `LANES`.
            unsafe {
                if any_far(rows[1][1], first, chunk, threshold) {
                    extrema_of_columns(rows, first, chunk, &mut most, &mut least);
                    for block in (0..chunk).step_by(LANES) {
                        let here = Lanes::load(rows[1][1], first + block);
                        let Some(hits) = hits(here, &most, &least, block, threshold) else { continue };
                        for (i, &hit) in hits.iter().enumerate() {
                            let column = first + block + i;
                            if hit != 0 && (next..end).contains(&column) {
                                columns.push(column as u32);
                            }
                        }
                    }
                }
            }
            next = end;
        }
    }
}

/// Whether one of the `chunk` samples from `first` on is farther than `threshold` from 0.
///
/// # Safety
/// `chunk` is a multiple of `LANES`, and `first + chunk` at most the length of the row.
#[inline(always)]
unsafe fn any_far(row: &[f32], first: usize, chunk: usize, threshold: f32) -> bool {
    let mut far = [0; LANES];
    for block in (0..chunk).step_by(LANES) {
        // SAFETY: the caller guarantees the lengths.
        let here = unsafe { Lanes::load(row, first + block) };
        for i in 0..LANES {
            far[i] |= u32::from(here.0[i].abs() > threshold);
        }
    }
    far.iter().fold(0, |any, far| any | far) != 0
}

/// Writes the largest and the smallest number of each column, over all rows.
///
/// # Safety
/// `chunk` is a multiple of `LANES` and at most `CHUNK`, and `first + chunk` at most the length of every row.
#[inline(always)]
unsafe fn extrema_of_columns(
    rows: &[[&[f32]; 3]; 3],
    first: usize,
    chunk: usize,
    most: &mut OfColumns,
    least: &mut OfColumns,
) {
    for block in (0..chunk).step_by(LANES) {
        let (mut high, mut low) = (Lanes::all(f32::NEG_INFINITY), Lanes::all(f32::INFINITY));
        for level in rows {
            for row in level {
                // SAFETY: the caller guarantees the lengths.
                let near = unsafe { Lanes::load(row, first + block) };
                high = high.max(near);
                low = low.min(near);
            }
        }
        // SAFETY: `block + 2 LANES` is at most the length of the arrays.
        unsafe {
            high.store(most, LANES + block);
            low.store(least, LANES + block);
        }
    }
}

/// Which of the samples `here`, in the columns from `block` of the chunk on, are peaks; `None` when none is.
///
/// # Safety
/// `block + LANES` is at most `CHUNK`.
#[inline(always)]
unsafe fn hits(
    here: Lanes,
    most: &OfColumns,
    least: &OfColumns,
    block: usize,
    threshold: f32,
) -> Option<[u32; LANES]> {
    let own = LANES + block;
    // SAFETY: `own + 1 + LANES` is at most the length of the arrays.
    let (high, low) = unsafe {
        let high = Lanes::load(most, own).max(Lanes::load(most, own - 1)).max(Lanes::load(most, own + 1));
        let low = Lanes::load(least, own).min(Lanes::load(least, own - 1)).min(Lanes::load(least, own + 1));
        (high, low)
    };
    let mut hits = [0; LANES];
    let mut any = 0;
    for i in 0..LANES {
        let here = here.0[i];
        let hit = u32::from(here > threshold) & u32::from(here >= high.0[i])
            | u32::from(here < -threshold) & u32::from(here <= low.0[i]);
        hits[i] = hit;
        any |= hit;
    }
    (any != 0).then_some(hits)
}
