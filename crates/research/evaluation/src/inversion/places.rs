//! From places in an image to cells of a grid: keypoints, answers of attacks, and lines as they were sent.

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{KnownSegment, Observation};
use veiloc_geometry::Pixel;

use crate::inversion::network::Grid;

/// Descriptor, cell, and how much of the descriptor lies there.
pub(crate) type Share = (u32, u32, f32);

/// Steps in which a line is followed.
const STEPS: usize = 64;

/// The cell at a place of an image of this size; `None` beyond it, and for a place that is none.
pub(crate) fn cell(place: Pixel, [width, height]: [u32; 2], grid: Grid) -> Option<u32> {
    let along = |at: f64, pixels: u32, cells: usize| {
        let at = at * cells as f64 / f64::from(pixels);
        // Written so that NaN is outside.
        (at >= 0.0 && at < cells as f64).then_some(at as usize)
    };
    let (x, y) = (along(place.u, width, grid.width)?, along(place.v, height, grid.height)?);
    Some((y * grid.width + x) as u32)
}

/// One place each.
pub(crate) fn at(places: &[Pixel], size: [u32; 2], grid: Grid) -> Vec<Share> {
    let share = |(i, place): (usize, &Pixel)| Some((i as u32, cell(*place, size, grid)?, 1.0));
    places.iter().enumerate().filter_map(share).collect()
}

/// Each spread over what was sent, by how likely the guess finds the keypoint there. What misses the image is left out.
pub(crate) fn along(observations: &[Observation], size: [u32; 2], grid: Grid) -> Vec<Share> {
    let mut shares: Vec<Share> = Vec::new();
    for (i, observation) in observations.iter().enumerate() {
        if let Observation::Known(place) = observation {
            shares.extend(cell(*place, size, grid).map(|cell| (i as u32, cell, 1.0)));
            continue;
        }
        for segment in KnownSegment::of(observation, size[0], size[1]).iter().filter(|s| !s.is_empty()) {
            let step = (segment.far - segment.near) / STEPS as f64;
            let middle = |k: usize| segment.near + (k as f64 + 0.5) * step;
            let whole: f64 = (0..STEPS).map(|k| segment.likelihood(middle(k))).sum();
            for k in 0..STEPS {
                let likely = segment.likelihood(middle(k)) / whole;
                let Some(cell) = cell(segment.at(middle(k)), size, grid) else { continue };
                let share =
                    (segment.share * if likely.is_finite() { likely } else { 1.0 / STEPS as f64 }) as f32;
                match shares.last_mut() {
                    Some(last) if last.0 == i as u32 && last.1 == cell => last.2 += share,
                    _ => shares.push((i as u32, cell, share)),
                }
            }
        }
    }
    shares
}

/// Wrong places are at least so many cells away.
const NEAREST_WRONG: f64 = 2.0;

/// Puts some of these places elsewhere, and tells which were left where they belong, `[N]`.
///
/// In half of the draws all are right; in the others a share of them up to `most` is wrong. A wrong place is anywhere, or off by
/// two cells to half the image, small errors as likely as large ones: attacks are off by both kinds. Draws nothing for a `most`
/// of nothing.
pub(crate) fn misplace(
    places: &mut [Pixel],
    size: [u32; 2],
    grid: Grid,
    most: f64,
    rng: &mut ChaCha8Rng,
) -> Vec<bool> {
    let mut right = vec![true; places.len()];
    if most <= 0.0 {
        return right;
    }
    let share = rng.random_range(-most..=most).max(0.0);
    let cell_side = f64::from(size[0]) / grid.width as f64;
    let [nearest, farthest] = [NEAREST_WRONG * cell_side, 0.5 * f64::from(size[0].max(size[1]))];
    for (place, right) in places.iter_mut().zip(&mut right) {
        if rng.random::<f64>() >= share {
            continue;
        }
        *right = false;
        let moved = if rng.random::<bool>() {
            let off = nearest * (farthest / nearest).max(1.0).powf(rng.random());
            let (sine, cosine) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
            Some(Pixel::new(place.u + off * cosine, place.v + off * sine))
        } else {
            None
        };
        // An attack that is off by so much leaves the image as often; what lies beyond it is not placed and teaches nothing.
        *place = moved.filter(|p| cell(*p, size, grid).is_some()).unwrap_or_else(|| {
            let [u, v] = size.map(|side| rng.random_range(0.0..f64::from(side)));
            Pixel::new(u, v)
        });
    }
    right
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use veiloc_geometry::{Pencils, PixelLine};

    use super::*;

    const SIZE: [u32; 2] = [640, 480];
    const GRID: Grid = Grid { width: 64, height: 48 };

    #[test]
    fn a_place_has_a_cell_and_what_lies_beyond_the_image_has_none() {
        assert_eq!(cell(Pixel::new(0.0, 0.0), SIZE, GRID), Some(0));
        assert_eq!(cell(Pixel::new(639.9, 479.9), SIZE, GRID), Some(64 * 48 - 1));
        assert_eq!(cell(Pixel::new(25.0, 31.0), SIZE, GRID), Some(3 * 64 + 2));
        for beyond in [[640.0, 1.0], [-0.1, 1.0], [1.0, 480.0], [f64::NAN, 1.0], [1.0, f64::INFINITY]] {
            assert_eq!(cell(Pixel::new(beyond[0], beyond[1]), SIZE, GRID), None, "{beyond:?}");
        }
        let places = [Pixel::new(-5.0, 1.0), Pixel::new(5.0, 1.0)];
        assert_eq!(at(&places, SIZE, GRID), [(1, 0, 1.0)]);
    }

    #[test]
    fn what_was_sent_is_spread_over_its_line() {
        let level = Observation::Line(PixelLine::through(Pixel::new(100.0, 7.0), 0.0));
        let pencils = Pencils::paper(640, 480);
        let keypoint = Pixel::new(200.0, 300.0);
        let anchor = pencils.anchor_of(keypoint);
        let row = Observation::anchored(&pencils, anchor, pencils.angle_of(anchor, keypoint));
        let known = Observation::Known(keypoint);
        let shares = along(&[level, row, known], SIZE, GRID);
        for i in 0..3 {
            let own: Vec<&Share> = shares.iter().filter(|s| s.0 == i).collect();
            assert!((own.iter().map(|s| s.2).sum::<f32>() - 1.0).abs() < 1e-4, "{i}");
            // Cell 20, 30; a line may cut a corner between two steps.
            let holds = own.iter().any(|s| (s.1 % 64).abs_diff(20) < 2 && (s.1 / 64).abs_diff(30) < 2);
            assert_eq!(holds, i > 0, "{i}");
        }
        let first: Vec<&Share> = shares.iter().filter(|s| s.0 == 0).collect();
        assert_eq!(first.len(), 64, "evenly along the row of cells");
        assert!(first.iter().all(|s| s.1 < 64 && (s.2 - 1.0 / 64.0).abs() < 1e-6));
        // Of a pencil what is far from the anchor is likelier.
        let far = |s: &&Share| (f64::from(s.1 / 64) - 12.0).abs() > 24.0;
        let own: Vec<&Share> = shares.iter().filter(|s| s.0 == 1).collect();
        assert!(own.iter().copied().filter(far).count() > 0, "it reaches across the image");
    }

    #[test]
    fn some_places_are_wrong_and_it_is_told_which() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let truth: Vec<Pixel> = (0..400).map(|i| Pixel::new(f64::from(i % 20) * 30.0 + 9.0, 200.0)).collect();
        let (mut whole, mut wrong, mut far) = (0, 0, 0);
        for _ in 0..100 {
            let mut places = truth.clone();
            let right = misplace(&mut places, SIZE, GRID, 0.6, &mut rng);
            whole += usize::from(right.iter().all(|right| *right));
            for ((place, truth), right) in places.iter().zip(&truth).zip(&right) {
                let off = (place.u - truth.u).hypot(place.v - truth.v);
                assert!(cell(*place, SIZE, GRID).is_some(), "it stays in the image");
                assert!(!right || off == 0.0);
                wrong += usize::from(!right);
                far += usize::from(!right && off > 100.0);
            }
        }
        assert!((35..65).contains(&whole), "{whole} of 100 without a wrong one");
        // A quarter of 0.6 in the mean.
        assert!((3500..8500).contains(&wrong), "{wrong} of 40000");
        assert!(far * 5 > wrong * 2 && far < wrong, "near and far: {far} of {wrong}");
        let before = rng.clone();
        let mut places = truth.clone();
        assert!(misplace(&mut places, SIZE, GRID, 0.0, &mut rng).iter().all(|right| *right));
        assert!(places == truth && rng == before, "nothing is drawn where nothing is wrong");
    }
}
