//! Dot products with AVX2.
//!
//! `maddubs` (bytes to saturated 16 bits) would saturate: `2 * 255 * 255` does not fit. Rows are widened to 16 bits and
//! multiplied by `madd`, which adds pairs into 32 bits and cannot overflow for bytes. Four queries share the widening.

use std::arch::x86_64::{
    __m256i, _mm_loadu_si128, _mm256_add_epi32, _mm256_cvtepu8_epi16, _mm256_hadd_epi32, _mm256_madd_epi16,
    _mm256_permute4x64_epi64, _mm256_set1_epi64x, _mm256_setzero_si256, _mm256_storeu_si256,
};

use super::{LANES, STEP, TILE_PANELS, TILE_QUERIES, Tile, TileDots};

/// 32-byte registers.
pub(crate) struct Avx2;

/// Queries that share one widened load; with 8 rows, 8 of the 16 registers are accumulators.
const QUERIES: usize = 4;
/// Bytes of 4 rows in one step.
const QUARTER: usize = 4 * STEP;
/// Bytes of all rows of a panel in one step.
const SLAB: usize = LANES * STEP;

impl Tile for Avx2 {
    type Component = i16;

    #[inline(always)]
    fn component(value: u8) -> i16 {
        i16::from(value)
    }

    #[inline(always)]
    unsafe fn dots(queries: &[i16], panels: &[u8], dots: &mut TileDots) {
        // SAFETY: the caller guarantees the feature.
        unsafe { dots_avx2(queries, panels, dots) }
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn dots_avx2(queries: &[i16], panels: &[u8], dots: &mut TileDots) {
    let panel_bytes = panels.len() / TILE_PANELS;
    for (panel, dots) in panels.chunks_exact(panel_bytes).zip(dots) {
        for (part, dots) in dots.chunks_exact_mut(QUERIES).enumerate() {
            for half in 0..2 {
                let sums = half_panel(queries, part, panel, half);
                for (sum, dots) in sums.into_iter().zip(&mut *dots) {
                    let (halves, _) = dots.0.as_chunks_mut::<8>();
                    // SAFETY: the target is 8 numbers of 32 bits, and the store needs no alignment.
                    unsafe { _mm256_storeu_si256(halves[half].as_mut_ptr().cast(), sum) }
                }
            }
        }
    }
}

/// Dot products of 4 queries with 8 rows of a panel: the first (0) or the last (1) ones of each.
#[inline]
#[target_feature(enable = "avx2")]
fn half_panel(queries: &[i16], part: usize, panel: &[u8], half: usize) -> [__m256i; QUERIES] {
    // Two partial sums per row, side by side: [r0 r0 r1 r1 r2 r2 r3 r3].
    let mut sums = [[_mm256_setzero_si256(); 2]; QUERIES];
    let (slabs, _) = panel.as_chunks::<SLAB>();
    let (steps, _) = queries.as_chunks::<{ TILE_QUERIES * STEP }>();
    for (slab, step) in slabs.iter().zip(steps) {
        let (quarters, _) = slab.as_chunks::<QUARTER>();
        let rows: [__m256i; 2] = std::array::from_fn(|i| {
            // SAFETY: a quarter is 16 bytes, and the load needs no alignment.
            let bytes = unsafe { _mm_loadu_si128(quarters[2 * half + i].as_ptr().cast()) };
            _mm256_cvtepu8_epi16(bytes)
        });
        let (step, _) = step.as_chunks::<STEP>();
        for (components, sums) in step[part * QUERIES..][..QUERIES].iter().zip(&mut sums) {
            let q = components.map(|v| u64::from(v as u16));
            let query = _mm256_set1_epi64x((q[0] | q[1] << 16 | q[2] << 32 | q[3] << 48) as i64);
            sums[0] = _mm256_add_epi32(sums[0], _mm256_madd_epi16(rows[0], query));
            sums[1] = _mm256_add_epi32(sums[1], _mm256_madd_epi16(rows[1], query));
        }
    }
    // `hadd` works within 128 bits: [r0 r1 r4 r5 | r2 r3 r6 r7]; the permutation puts rows in order.
    sums.map(|[low, high]| _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_hadd_epi32(low, high)))
}
