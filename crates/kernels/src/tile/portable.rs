//! Dot products in plain Rust: the twin of the others, and the kernel of every machine without them.

use super::{LANES, STEP, TILE_PANELS, TILE_QUERIES, Tile, TileDots};

/// No special instructions.
pub(crate) struct Portable;

impl Tile for Portable {
    type Component = u8;

    #[inline(always)]
    fn component(value: u8) -> u8 {
        value
    }

    #[inline(always)]
    unsafe fn dots(queries: &[u8], panels: &[u8], dots: &mut TileDots) {
        let padded_dim = queries.len() / TILE_QUERIES;
        let panel_bytes = panels.len() / TILE_PANELS;
        for (panel, dots) in panels.chunks_exact(panel_bytes).zip(dots) {
            for (query, dots) in queries.chunks_exact(padded_dim).zip(dots) {
                let mut sums = [0_i32; LANES];
                let (slabs, _) = panel.as_chunks::<{ LANES * STEP }>();
                let (steps, _) = query.as_chunks::<STEP>();
                for (slab, step) in slabs.iter().zip(steps) {
                    for lane in 0..LANES {
                        for i in 0..STEP {
                            sums[lane] += i32::from(slab[lane * STEP + i]) * i32::from(step[i]);
                        }
                    }
                }
                dots.0 = sums;
            }
        }
    }
}
