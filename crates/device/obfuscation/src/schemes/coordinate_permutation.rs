//! `coordinate-permutation`: keypoints are paired at random, and each pair exchanges one coordinate.
//!
//! After Pan et al. (paper, Sec. 2 and Fig. 5c). One coordinate of a sent position is the keypoint's own and the other
//! is its partner's; the query does not say which. The keypoint lies on the vertical or on the horizontal line through
//! the sent position.

use rand::Rng;
use rand::seq::SliceRandom;
use veiloc_protocol::{PositionRow, Rows};

use super::each;
use crate::SealError;

/// One row per position. `from_center`: `[u, v]` from `center`, the image's centre, dithered, pixels.
pub(super) fn rows<R: Rng + ?Sized>(
    mut from_center: Vec<[f64; 2]>,
    center: [f64; 2],
    rng: &mut R,
) -> Result<Rows, SealError> {
    permute(&mut from_center, center, rng);
    Ok(Rows::CoordinatePermutation(each(&from_center, |&[u, v]| PositionRow::new(u, v))?))
}

/// Pairs all positions at random and exchanges one coordinate within each pair, `u` or `v` with equal probability.
///
/// For an odd number, the last three form a ring and pass the coordinate on. A single position has no partner and gets
/// a coordinate drawn uniformly from the image.
fn permute<R: Rng + ?Sized>(positions: &mut [[f64; 2]], center: [f64; 2], rng: &mut R) {
    if let [only] = positions {
        let axis = usize::from(rng.random::<bool>());
        only[axis] = (rng.random::<f64>() * 2.0 - 1.0) * center[axis];
        return;
    }
    let mut order: Vec<usize> = (0..positions.len()).collect();
    order.shuffle(rng);
    let mut rest = order.as_slice();
    while !rest.is_empty() {
        let (ring, after) = rest.split_at(if rest.len() == 3 { 3 } else { 2 });
        let axis = usize::from(rng.random::<bool>());
        let first = positions[ring[0]][axis];
        for pair in ring.windows(2) {
            positions[pair[0]][axis] = positions[pair[1]][axis];
        }
        positions[ring[ring.len() - 1]][axis] = first;
        rest = after;
    }
}
