//! Where descriptors come onto the grid: each shortened by one matrix, put into its cells, with what is told of each cell.

use veiloc_attacks::training::Matrix;
use veiloc_attacks::training::layers::{Linear, Places};

use super::Placed;

/// Numbers a cell is told by beside descriptors: how full it is, and where it is.
pub(super) const MORE: usize = 3;

/// The matrix, and how many channels it leaves.
#[derive(Debug, Clone)]
pub(super) struct Front {
    matrix: Linear,
    width: usize,
}

impl Front {
    pub(super) fn new(places: &mut Places, dimension: usize, width: usize) -> Self {
        Self { matrix: places.linear(dimension, width), width }
    }

    /// What stands on the grid: `[width + MORE, cells]`, and how full each cell is.
    pub(super) fn forward(&self, numbers: &[f32], placed: &Placed) -> (Matrix, Vec<f32>) {
        let grid = placed.grid;
        let width = self.width;
        let short = self.matrix.forward(numbers, &placed.descriptors);
        let full = placed.full();
        let mut x = Matrix::zeros(width + MORE, grid.cells());
        for (descriptor, cell, share) in &placed.shares {
            // What shares a cell is averaged; a cell that is hardly full stays faint.
            let share = share / full[*cell as usize].max(1.0);
            let from = &short.as_slice()[width * *descriptor as usize..][..width];
            let to = &mut x.as_mut_slice()[(width + MORE) * *cell as usize..][..width];
            to.iter_mut().zip(from).for_each(|(t, f)| *t += share * f);
        }
        let along = |at: usize, side: usize| (2 * at + 1) as f32 / side as f32 - 1.0;
        for (cell, column) in x.as_mut_slice().chunks_exact_mut(width + MORE).enumerate() {
            column[width] = full[cell].ln_1p();
            column[width + 1] = along(cell % grid.width, grid.width);
            column[width + 2] = along(cell / grid.width, grid.height);
        }
        (x, full)
    }

    /// Adds to the derivatives of the matrix, from those of what stands on the grid.
    pub(super) fn learn(&self, slopes: &mut [f32], placed: &Placed, full: &[f32], d: &Matrix) {
        if placed.shares.is_empty() {
            return;
        }
        let width = self.width;
        let mut short = Matrix::zeros(width, placed.descriptors.ncols());
        for (descriptor, cell, share) in &placed.shares {
            let share = share / full[*cell as usize].max(1.0);
            let from = &d.as_slice()[(width + MORE) * *cell as usize..][..width];
            let to = &mut short.as_mut_slice()[width * *descriptor as usize..][..width];
            to.iter_mut().zip(from).for_each(|(t, f)| *t += share * f);
        }
        self.matrix.learn(slopes, &placed.descriptors, &short);
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::super::Grid;
    use super::*;

    #[test]
    fn descriptors_in_one_cell_are_averaged_and_their_order_is_nothing() {
        let grid = Grid { width: 4, height: 4 };
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut places = Places::default();
        let front = Front::new(&mut places, 2, 3);
        let numbers = places.draw(&mut rng);
        let of = |descriptors: &[f32], shares: Vec<(u32, u32, f32)>| {
            let descriptors = Matrix::from_column_slice(2, descriptors.len() / 2, descriptors);
            front.forward(&numbers, &Placed { grid, descriptors, shares }).0
        };
        let both = of(&[1.0, 0.0, 0.0, 1.0], vec![(0, 5, 1.0), (1, 5, 1.0)]);
        let turned = of(&[0.0, 1.0, 1.0, 0.0], vec![(0, 5, 1.0), (1, 5, 1.0)]);
        let mean = of(&[0.5, 0.5], vec![(0, 5, 1.0)]);
        assert_eq!(both, turned);
        for row in 0..3 {
            assert!((both[(row, 5)] - mean[(row, 5)]).abs() < 1e-6);
        }
        assert!(both[(3, 5)] > mean[(3, 5)], "but the cell is fuller");
        let empty = of(&[1.0, 0.0], vec![]);
        assert!((0..16).all(|cell| empty.column(cell).iter().take(4).all(|v| *v == 0.0)));
    }
}
