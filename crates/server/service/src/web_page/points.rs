//! A map's points, thinned, for a page to show its user where they are.
//!
//! They say what the map's place looks like to whoever may ask for the map, so an operator says how many there are to be.

use veiloc_map::{MapFile, PointId};

use crate::web_page::Content;

/// At most so many points of a map, evenly from all of it: x, y, z as 32-bit floats, little endian, map units.
///
/// The same points each time; half of them are among those of twice as many.
pub fn thinned(map: &MapFile, most: usize) -> Content {
    let count = map.point_count();
    let shown = order(count).take(most.min(count));
    let numbers = shown.flat_map(|index| {
        let point = map.point(PointId(index as u32));
        <[f64; 3]>::from(point.coords).into_iter().flat_map(|x| (x as f32).to_le_bytes())
    });
    Content::new(numbers.collect::<Vec<u8>>())
}

/// Every index below `count` once, in an order whose beginnings are spread: steps of the golden section.
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
    fn every_point_comes_once_and_beginnings_are_spread() {
        for count in [0, 1, 2, 3, 10, 97, 1000, 4096] {
            let mut all: Vec<usize> = order(count).collect();
            let half: Vec<usize> = all[..count / 2].to_vec();
            let low = half.iter().filter(|index| **index < count / 2).count();
            // The golden section leaves gaps that grow with the logarithm; one part after the other would be off by a quarter.
            assert!(
                low.abs_diff(count / 4) <= 2 + count / 64,
                "{count}: {low} of the first half lie in the lower one"
            );
            all.sort_unstable();
            assert_eq!(all, (0..count).collect::<Vec<_>>());
        }
    }
}
