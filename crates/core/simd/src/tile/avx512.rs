//! Dot products with AVX-512 VNNI.
//!
//! One instruction multiplies 64 unsigned by 64 signed bytes and adds groups of four into 16 sums of 32 bits, without
//! saturation. Queries are stored as `q - 128` to be signed; [`crate::PackedRows`] corrects for it.

use std::arch::x86_64::{
    __m512i, _mm512_dpbusd_epi32, _mm512_loadu_si512, _mm512_set1_epi32, _mm512_setzero_si512,
    _mm512_storeu_si512,
};

use super::{LANES, STEP, TILE_PANELS, TILE_QUERIES, Tile, TileDots};

/// 64-byte registers.
pub(crate) struct Avx512Vnni;

/// Bytes of all rows of a panel in one step: one register.
const SLAB: usize = LANES * STEP;

impl Tile for Avx512Vnni {
    type Component = i8;

    #[inline(always)]
    fn component(value: u8) -> i8 {
        (value ^ 0x80) as i8 // value - 128
    }

    #[inline(always)]
    unsafe fn dots(queries: &[i8], panels: &[u8], dots: &mut TileDots) {
        // SAFETY: the caller guarantees the features.
        unsafe { dots_avx512(queries, panels, dots) }
    }
}

#[inline]
#[target_feature(enable = "avx2,avx512f,avx512bw,avx512vl,avx512vnni")]
fn dots_avx512(queries: &[i8], panels: &[u8], dots: &mut TileDots) {
    let (slabs, _) = panels.as_chunks::<SLAB>();
    let (steps, _) = queries.as_chunks::<{ TILE_QUERIES * STEP }>();
    let (first, second) = slabs.split_at(slabs.len() / TILE_PANELS);
    let mut sums = [[_mm512_setzero_si512(); TILE_QUERIES]; TILE_PANELS];
    for ((first, second), step) in first.iter().zip(second).zip(steps) {
        let rows: [__m512i; TILE_PANELS] = [first, second].map(|slab| {
            // SAFETY: a slab is 64 bytes, and the load needs no alignment.
            unsafe { _mm512_loadu_si512(slab.as_ptr().cast()) }
        });
        let (step, _) = step.as_chunks::<STEP>();
        for (q, components) in step.iter().enumerate() {
            let query = _mm512_set1_epi32(i32::from_ne_bytes(components.map(|v| v as u8)));
            for p in 0..TILE_PANELS {
                sums[p][q] = _mm512_dpbusd_epi32(sums[p][q], rows[p], query);
            }
        }
    }
    for (dots, sums) in dots.iter_mut().flatten().zip(sums.iter().flatten()) {
        // SAFETY: the target is 16 numbers of 32 bits, and the store needs no alignment.
        unsafe { _mm512_storeu_si512(dots.0.as_mut_ptr().cast(), *sums) }
    }
}
