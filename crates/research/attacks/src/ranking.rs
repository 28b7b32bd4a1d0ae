//! The most likely neighbours of every keypoint, from a matrix of pair scores that is computed in blocks.

use rayon::prelude::*;
use veiloc_geometry::nalgebra::DMatrix;

/// Rows of the score matrix per block.
const BLOCK: usize = 256;

/// For each keypoint `i` the `k` others with the greatest `xⱼᵀ wᵢ − ownⱼ`, greatest first; ties are ordered by index.
///
/// `x` and `w` are `[dimension, N]`, `own` is `[N]`.
pub fn likeliest_pairs(x: &DMatrix<f32>, w: &DMatrix<f32>, own: &[f32], k: usize) -> Vec<Vec<u32>> {
    let starts: Vec<usize> = (0..x.ncols()).step_by(BLOCK).collect();
    let blocks: Vec<Vec<Vec<u32>>> = starts
        .into_par_iter()
        .map(|start| {
            let rows = BLOCK.min(x.ncols() - start);
            // Transposed, so that the scores of one keypoint are one contiguous column.
            let scores = x.tr_mul(&w.columns(start, rows));
            let best = |r: usize| likeliest(scores.column(r).as_slice(), own, start + r, k);
            (0..rows).map(best).collect()
        })
        .collect();
    blocks.concat()
}

/// The `k` greatest of `products[j] − own[j]` without `i` itself.
fn likeliest(products: &[f32], own: &[f32], i: usize, k: usize) -> Vec<u32> {
    let mut scored: Vec<(f32, u32)> = products
        .iter()
        .zip(own)
        .enumerate()
        .filter(|(j, _)| *j != i)
        .map(|(j, (p, o))| (p - o, j as u32))
        .collect();
    let order = |a: &(f32, u32), b: &(f32, u32)| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1));
    if k > 0 && scored.len() > k {
        scored.select_nth_unstable_by(k - 1, order);
    }
    scored.truncate(k);
    scored.sort_unstable_by(order);
    scored.into_iter().map(|s| s.1).collect()
}
