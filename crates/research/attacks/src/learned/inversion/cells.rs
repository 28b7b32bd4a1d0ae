//! From positions in an image to cells of a grid: keypoints, recovered positions and sent lines.

use veiloc_geometry::Pixel;

use super::grid::Grid;
use crate::{KnownSegment, Observation};

/// Descriptor, cell, and the share of the descriptor in that cell.
pub(super) type CellShare = (u32, u32, f32);

/// Number of samples along a line.
const STEPS: usize = 64;

/// The cell at a position in an image of this size; `None` outside the image and for positions that are not finite.
fn cell(position: Pixel, [width, height]: [u32; 2], grid: Grid) -> Option<u32> {
    let along = |at: f64, pixels: u32, cells: usize| {
        let at = at * cells as f64 / f64::from(pixels);
        // Written so that NaN is outside.
        (at >= 0.0 && at < cells as f64).then_some(at as usize)
    };
    let (x, y) = (along(position.u, width, grid.width)?, along(position.v, height, grid.height)?);
    Some((y * grid.width + x) as u32)
}

/// One position per descriptor.
pub(super) fn at(positions: &[Pixel], size: [u32; 2], grid: Grid) -> Vec<CellShare> {
    let share = |(i, position): (usize, &Pixel)| Some((i as u32, cell(*position, size, grid)?, 1.0));
    positions.iter().enumerate().filter_map(share).collect()
}

/// Each descriptor spread over its observation by the prior-only likelihood of the keypoint. The part outside the
/// image is left out.
pub(super) fn along(observations: &[Observation], size: [u32; 2], grid: Grid) -> Vec<CellShare> {
    let mut shares: Vec<CellShare> = Vec::new();
    for (i, observation) in observations.iter().enumerate() {
        if let Observation::Known(position) = observation {
            shares.extend(cell(*position, size, grid).map(|cell| (i as u32, cell, 1.0)));
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

#[cfg(test)]
mod tests {
    use veiloc_geometry::{Pencils, PixelLine};

    use super::*;

    const SIZE: [u32; 2] = [640, 480];
    const GRID: Grid = Grid { width: 64, height: 48 };

    #[test]
    fn positions_outside_the_image_have_no_cell() {
        assert_eq!(cell(Pixel::new(0.0, 0.0), SIZE, GRID), Some(0));
        assert_eq!(cell(Pixel::new(639.9, 479.9), SIZE, GRID), Some(64 * 48 - 1));
        assert_eq!(cell(Pixel::new(25.0, 31.0), SIZE, GRID), Some(3 * 64 + 2));
        for beyond in [[640.0, 1.0], [-0.1, 1.0], [1.0, 480.0], [f64::NAN, 1.0], [1.0, f64::INFINITY]] {
            assert_eq!(cell(Pixel::new(beyond[0], beyond[1]), SIZE, GRID), None, "{beyond:?}");
        }
        let positions = [Pixel::new(-5.0, 1.0), Pixel::new(5.0, 1.0)];
        assert_eq!(at(&positions, SIZE, GRID), [(1, 0, 1.0)]);
    }

    #[test]
    fn descriptors_are_spread_over_their_lines() {
        let level = Observation::Line(PixelLine::through(Pixel::new(100.0, 7.0), 0.0));
        let pencils = Pencils::paper(640, 480);
        let keypoint = Pixel::new(200.0, 300.0);
        let anchor = pencils.anchor_of(keypoint);
        let row = Observation::anchored(&pencils, anchor, pencils.angle_of(anchor, keypoint));
        let known = Observation::Known(keypoint);
        let shares = along(&[level, row, known], SIZE, GRID);
        for i in 0..3 {
            let own: Vec<&CellShare> = shares.iter().filter(|s| s.0 == i).collect();
            assert!((own.iter().map(|s| s.2).sum::<f32>() - 1.0).abs() < 1e-4, "{i}");
            // Cell 20, 30; a line may cut a corner between two steps.
            let holds = own.iter().any(|s| (s.1 % 64).abs_diff(20) < 2 && (s.1 / 64).abs_diff(30) < 2);
            assert_eq!(holds, i > 0, "{i}");
        }
        let first: Vec<&CellShare> = shares.iter().filter(|s| s.0 == 0).collect();
        assert_eq!(first.len(), 64, "evenly along the row of cells");
        assert!(first.iter().all(|s| s.1 < 64 && (s.2 - 1.0 / 64.0).abs() < 1e-6));
        // In a pencil, positions far from the anchor are likelier.
        let far = |s: &&CellShare| (f64::from(s.1 / 64) - 12.0).abs() > 24.0;
        let own: Vec<&CellShare> = shares.iter().filter(|s| s.0 == 1).collect();
        assert!(own.iter().copied().filter(far).count() > 0, "it reaches across the image");
    }
}
