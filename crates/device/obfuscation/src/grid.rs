//! The grid on which a session quantizes angles: fixed with its anchors, shifted by a secret of the session.

use std::f64::consts::TAU;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha20Rng;
use veiloc_geometry::Anchor;

/// Cells of angle about each anchor. The middle of the cell is sent instead of the angle, so every frame sends the same
/// angle for a keypoint that is seen again, as long as detector noise keeps it within the cell.
///
/// The shift of the cells is drawn for each session and anchor from the session's key. Within a session all frames have
/// the same cells; the cells of two sessions overlap at random offsets that no attacker can choose.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct AngleGrid {
    /// Width of a cell, radians; the full circle is a whole number of cells.
    step: f64,
    /// Offset of the first cell about each anchor, in cells.
    shift: [f64; Anchor::MAX_COUNT],
}

impl AngleGrid {
    /// The grid of a session's key for its `start`-th layout, with cells of about `step` radians, above 0.
    pub(crate) fn new(key: &[u8; 32], start: u32, step: f64) -> Self {
        let cells = (TAU / step).round().max(1.0);
        let mut rng = ChaCha20Rng::from_seed(*key);
        rng.set_stream(start.into());
        Self { step: TAU / cells, shift: std::array::from_fn(|_| rng.random()) }
    }

    /// The middle of the cell of an angle, `[0, 2π)`.
    pub(crate) fn middle(&self, anchor: Anchor, angle: f64) -> f64 {
        let shift = self.shift[anchor.index()];
        ((angle / self.step + shift).floor() + 0.5 - shift) * self.step
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_close_and_depend_on_key_start_and_anchor() {
        let grid = AngleGrid::new(&[7; 32], 1, 0.004);
        let mut middles = std::collections::BTreeSet::new();
        for k in 0..20_000 {
            let angle = TAU * f64::from(k) / 20_000.0;
            let middle = grid.middle(Anchor::FIRST, angle);
            assert!((middle - angle).abs() <= 0.5 * grid.step + 1e-12);
            assert!((grid.middle(Anchor::FIRST, middle) - middle).abs() < 1e-9);
            middles.insert((middle.rem_euclid(TAU) * 1e9).round() as i64);
        }
        // The cell at the seam is reached from both sides.
        assert_eq!(middles.len(), (TAU / 0.004).round() as usize);
        assert_ne!(grid.shift[0], grid.shift[1]);
        assert_ne!(grid, AngleGrid::new(&[8; 32], 1, 0.004));
        assert_ne!(grid, AngleGrid::new(&[7; 32], 2, 0.004));
    }
}
