//! `coordinate-permutation`: keypoints are paired at random, and each pair exchanges one coordinate.
//!
//! After Pan et al. (paper, Sec. 2 and Fig. 4). Of a sent position one coordinate is the keypoint's own and the other its partner's,
//! and nothing says which: the keypoint lies on the vertical or on the horizontal line through it.

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

/// Pairs all places at random and exchanges one coordinate within each pair, `u` or `v` by the toss of a coin.
///
/// Of an odd number, the last three form a ring and pass the coordinate on. A single place has nobody to exchange
/// with and gets a coordinate drawn uniformly from the image.
fn permute<R: Rng + ?Sized>(places: &mut [[f64; 2]], center: [f64; 2], rng: &mut R) {
    if let [only] = places {
        let axis = usize::from(rng.random::<bool>());
        only[axis] = (rng.random::<f64>() * 2.0 - 1.0) * center[axis];
        return;
    }
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.shuffle(rng);
    let mut rest = order.as_slice();
    while !rest.is_empty() {
        let (ring, after) = rest.split_at(if rest.len() == 3 { 3 } else { 2 });
        let axis = usize::from(rng.random::<bool>());
        let first = places[ring[0]][axis];
        for pair in ring.windows(2) {
            places[pair[0]][axis] = places[pair[1]][axis];
        }
        places[ring[ring.len() - 1]][axis] = first;
        rest = after;
    }
}
