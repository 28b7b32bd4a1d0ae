//! A subset of the map points, for display on the web page.
//!
//! The points reveal the shape of the mapped scene to clients that may use the map, so the operator sets their
//! number.

use veiloc_map::{MapFile, PointId};

use crate::web_page::Content;

/// At most `most` points, spread evenly over the map: x, y, z as 32-bit floats, little endian, map units.
///
/// Deterministic; a smaller subset is part of each larger one.
pub fn subsampled_points(map: &MapFile, most: usize) -> Content {
    let count = map.point_count();
    let shown = order(count).take(most.min(count));
    let numbers = shown.flat_map(|index| {
        let point = map.point(PointId(index as u32));
        <[f64; 3]>::from(point.coords).into_iter().flat_map(|x| (x as f32).to_le_bytes())
    });
    Content::new(numbers.collect::<Vec<u8>>())
}

/// A permutation of the indexes below `count` whose prefixes are spread evenly: steps of the golden section.
fn order(count: usize) -> impl Iterator<Item = usize> {
    let mut step = (count as f64 * 0.618_033_988_749_895) as usize;
    while count > 1 && gcd(step, count) != 1 {
        step += 1;
    }
    (0..count).map(move |i| (i as u64 * step as u64 % count.max(1) as u64) as usize)
}

const fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_is_a_permutation_with_spread_prefixes() {
        for count in [0, 1, 2, 3, 10, 97, 1000, 4096] {
            let mut all: Vec<usize> = order(count).collect();
            let half: Vec<usize> = all[..count / 2].to_vec();
            let low = half.iter().filter(|index| **index < count / 2).count();
            // The gaps of the golden section grow with the logarithm; a sequential order would be off by a quarter.
            assert!(
                low.abs_diff(count / 4) <= 2 + count / 64,
                "{count}: {low} of the first half lie in the lower one"
            );
            all.sort_unstable();
            assert_eq!(all, (0..count).collect::<Vec<_>>());
        }
    }
}
