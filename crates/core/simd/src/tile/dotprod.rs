//! Dot products with the instruction `udot` of aarch64 (FEAT_DotProd, in phones since about 2018).
//!
//! One instruction adds the products of four components for each of four rows. Its intrinsic is not stable in Rust
//! (`stdarch_neon_dotprod`), so it is written as assembly.

use std::arch::aarch64::{uint8x16_t, uint32x4_t, vdupq_n_u32, vld1q_u8, vst1q_u32};
use std::arch::asm;

use super::{LANES, STEP, TILE_PANELS, TILE_QUERIES, Tile, TileDots};

/// 16-byte registers with dot products.
pub(crate) struct DotProd;

/// Queries that share loaded rows; with four registers of rows each, 16 of the 32 registers are accumulators.
const QUERIES: usize = 4;
/// Registers of the rows of a panel in one step.
const QUARTERS: usize = 4;

impl Tile for DotProd {
    type Component = u8;

    #[inline(always)]
    fn component(value: u8) -> u8 {
        value
    }

    #[inline(always)]
    unsafe fn dots(queries: &[u8], panels: &[u8], dots: &mut TileDots) {
        // SAFETY: the caller guarantees the feature.
        unsafe { dots_udot(queries, panels, dots) }
    }
}

#[inline]
#[target_feature(enable = "dotprod")]
fn dots_udot(queries: &[u8], panels: &[u8], dots: &mut TileDots) {
    let panel_bytes = panels.len() / TILE_PANELS;
    for (panel, dots) in panels.chunks_exact(panel_bytes).zip(dots) {
        for (part, dots) in dots.chunks_exact_mut(QUERIES).enumerate() {
            for (sums, dots) in part_of_panel(queries, part, panel).into_iter().zip(dots) {
                let (quarters, _) = dots.0.as_chunks_mut::<{ LANES / QUARTERS }>();
                for (sum, quarter) in sums.into_iter().zip(quarters) {
                    // SAFETY: the target is 4 numbers of 32 bits, and the store needs no other alignment.
                    unsafe { vst1q_u32(quarter.as_mut_ptr().cast(), sum) }
                }
            }
        }
    }
}

/// Dot products of 4 queries with the rows of a panel.
#[inline]
#[target_feature(enable = "dotprod")]
fn part_of_panel(queries: &[u8], part: usize, panel: &[u8]) -> [[uint32x4_t; QUARTERS]; QUERIES] {
    let mut sums = [[vdupq_n_u32(0); QUARTERS]; QUERIES];
    let (slabs, _) = panel.as_chunks::<{ LANES * STEP }>();
    let (steps, _) = queries.as_chunks::<{ TILE_QUERIES * STEP }>();
    for (slab, step) in slabs.iter().zip(steps) {
        let (parts, _) = step.as_chunks::<{ QUERIES * STEP }>();
        let (quarters, _) = slab.as_chunks::<{ LANES * STEP / QUARTERS }>();
        // SAFETY: both are 16 bytes, and the load needs no alignment.
        let query = unsafe { vld1q_u8(parts[part].as_ptr()) };
        for (i, quarter) in quarters.iter().enumerate() {
            // SAFETY: as above.
            let rows = unsafe { vld1q_u8(quarter.as_ptr()) };
            sums[0][i] = udot::<0>(sums[0][i], rows, query);
            sums[1][i] = udot::<1>(sums[1][i], rows, query);
            sums[2][i] = udot::<2>(sums[2][i], rows, query);
            sums[3][i] = udot::<3>(sums[3][i], rows, query);
        }
    }
    sums
}

/// Adds the dot products of each row's four components with those of query `QUERY`.
#[inline]
#[target_feature(enable = "dotprod")]
fn udot<const QUERY: i32>(mut sums: uint32x4_t, rows: uint8x16_t, queries: uint8x16_t) -> uint32x4_t {
    // SAFETY: it only computes, and this function is compiled for its feature.
    unsafe {
        asm!(
            "udot {sums:v}.4s, {rows:v}.16b, {queries:v}.4b[{query}]",
            sums = inout(vreg) sums,
            rows = in(vreg) rows,
            queries = in(vreg) queries,
            query = const QUERY,
            options(pure, nomem, nostack, preserves_flags),
        );
    }
    sums
}
