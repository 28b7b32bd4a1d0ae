//! Dot products in plain Rust: the reference for the others, and the kernel of every machine without them.

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
        let panel_bytes = panels.len() / TILE_PANELS;
        let (steps, _) = queries.as_chunks::<{ TILE_QUERIES * STEP }>();
        for (panel, dots) in panels.chunks_exact(panel_bytes).zip(dots) {
            let (slabs, _) = panel.as_chunks::<{ LANES * STEP }>();
            for (q, dots) in dots.iter_mut().enumerate() {
                let mut sums = [0_i32; LANES];
                for (slab, step) in slabs.iter().zip(steps) {
                    // One word per row: its four components are then extracted by shifts only, and compilers see that
                    // the factors are short, for which every machine has a vector product.
                    let (rows, _) = slab.as_chunks::<STEP>();
                    let query: [i32; STEP] = std::array::from_fn(|i| i32::from(step[q * STEP + i]));
                    for lane in 0..LANES {
                        let row = u32::from_le_bytes(rows[lane]);
                        for i in 0..STEP {
                            sums[lane] += (row >> (8 * i) & 0xff) as i32 * query[i];
                        }
                    }
                }
                dots.0 = sums;
            }
        }
    }
}
