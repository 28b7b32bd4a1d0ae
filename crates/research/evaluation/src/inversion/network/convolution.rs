//! A convolution of 3 x 3 cells over a grid, zeros beyond its edges: the products of a matrix with unfolded cells.
//!
//! A map is a matrix `[channels, cells]`, a cell a **column**, cells row by row. The nine cells about one are three pieces of
//! memory, so that unfolding copies three times. Rows of the grid are worked on a few at a time, so that what is unfolded stays
//! near the processor; the way back unfolds again and keeps nothing.

use std::ops::Range;

use veiloc_attacks::training::Matrix;
use veiloc_attacks::training::layers::{Linear, Places};
use veiloc_geometry::nalgebra::{DMatrixView, DMatrixViewMut};

use super::Grid;

/// Unfolded numbers that are held at once, about: they fit the second cache.
const HELD: usize = 1 << 17;

/// A convolution with a bias.
#[derive(Debug, Clone, Copy)]
pub(super) struct Convolution {
    /// Of the nine cells, row by row, to the new channels.
    matrix: Linear,
    from: usize,
    to: usize,
}

impl Convolution {
    pub(super) fn new(places: &mut Places, from: usize, to: usize) -> Self {
        Self { matrix: places.linear(9 * from, to), from, to }
    }

    fn kernel<'a>(&self, numbers: &'a [f32]) -> DMatrixView<'a, f32> {
        DMatrixView::from_slice(&numbers[self.matrix.weights()], self.to, 9 * self.from)
    }

    /// Where its biases stand: behind the matrix.
    fn biases(&self) -> Range<usize> {
        let end = self.matrix.weights().end;
        end..end + self.to
    }

    /// The rows of the grid, a few at a time.
    fn strips(&self, grid: Grid) -> impl Iterator<Item = Range<usize>> {
        let at_once = (HELD / (9 * self.from * grid.width).max(1)).max(1);
        (0..grid.height).step_by(at_once).map(move |first| first..(first + at_once).min(grid.height))
    }

    /// `[from, cells]` → `[to, cells]`.
    pub(super) fn forward(&self, numbers: &[f32], grid: Grid, x: &Matrix) -> Matrix {
        let mut y = Matrix::zeros(self.to, grid.cells());
        let bias = &numbers[self.biases()];
        y.as_mut_slice().chunks_exact_mut(self.to).for_each(|column| column.copy_from_slice(bias));
        let mut unfolded = Vec::new();
        for rows in self.strips(grid) {
            let count = rows.len() * grid.width;
            unfold(x.as_slice(), self.from, grid, rows.clone(), &mut unfolded);
            let columns = DMatrixView::from_slice(&unfolded, 9 * self.from, count);
            let own = &mut y.as_mut_slice()[self.to * rows.start * grid.width..][..self.to * count];
            DMatrixViewMut::from_slice(own, self.to, count).gemm(1.0, &self.kernel(numbers), &columns, 1.0);
        }
        y
    }

    /// Adds to the derivatives of its numbers and returns those of what came in.
    pub(super) fn backward(
        &self,
        numbers: &[f32],
        slopes: &mut [f32],
        grid: Grid,
        x: &Matrix,
        dy: &Matrix,
    ) -> Matrix {
        let height = 9 * self.from;
        let mut dx = Matrix::zeros(self.from, grid.cells());
        // The small factors are turned, never what was unfolded: a plain product is blocked, one with a transpose is not.
        let kernel = self.kernel(numbers).transpose();
        let mut of_kernel = Matrix::zeros(height, self.to);
        let mut unfolded = Vec::new();
        for rows in self.strips(grid) {
            let count = rows.len() * grid.width;
            unfold(x.as_slice(), self.from, grid, rows.clone(), &mut unfolded);
            let dy = &dy.as_slice()[self.to * rows.start * grid.width..][..self.to * count];
            let dy = DMatrixView::from_slice(dy, self.to, count);
            of_kernel.gemm(1.0, &DMatrixView::from_slice(&unfolded, height, count), &dy.transpose(), 1.0);
            // What was unfolded is done with: its memory takes the derivatives.
            DMatrixViewMut::from_slice(&mut unfolded, height, count).gemm(1.0, &kernel, &dy, 0.0);
            fold(&unfolded, self.from, grid, rows, dx.as_mut_slice());
        }
        let of_kernel = of_kernel.transpose();
        let own = &mut slopes[self.matrix.weights()];
        own.iter_mut().zip(of_kernel.as_slice()).for_each(|(s, d)| *s += d);
        let biases = &mut slopes[self.biases()];
        for column in dy.as_slice().chunks_exact(self.to) {
            biases.iter_mut().zip(column).for_each(|(s, d)| *s += d);
        }
        dx
    }
}

/// Which part of the three cells about `x` in a row lies in the grid: the first of them, and the place of that in nine.
fn beside(x: usize, width: usize) -> (Range<usize>, usize) {
    let first = x.saturating_sub(1);
    (first..(x + 2).min(width), usize::from(x == 0))
}

/// The nine cells about each cell of these rows, zeros beyond the edges: `[9 · channels, rows · width]`.
fn unfold(map: &[f32], channels: usize, grid: Grid, rows: Range<usize>, out: &mut Vec<f32>) {
    out.clear();
    out.resize(9 * channels * rows.len() * grid.width, 0.0);
    let mut columns = out.chunks_exact_mut(9 * channels);
    for y in rows {
        for x in 0..grid.width {
            let Some(column) = columns.next() else { return };
            let (cells, skipped) = beside(x, grid.width);
            for ky in 0..3 {
                // What lies above the first row is a number too large for any.
                let row = (y + ky).wrapping_sub(1);
                if row < grid.height {
                    let from = &map[channels * (row * grid.width + cells.start)..][..channels * cells.len()];
                    column[channels * (3 * ky + skipped)..][..from.len()].copy_from_slice(from);
                }
            }
        }
    }
}

/// The other way: adds what stands for each of the nine to its cell.
fn fold(columns: &[f32], channels: usize, grid: Grid, rows: Range<usize>, map: &mut [f32]) {
    let mut columns = columns.chunks_exact(9 * channels);
    for y in rows {
        for x in 0..grid.width {
            let Some(column) = columns.next() else { return };
            let (cells, skipped) = beside(x, grid.width);
            for ky in 0..3 {
                let row = (y + ky).wrapping_sub(1);
                if row < grid.height {
                    let to =
                        &mut map[channels * (row * grid.width + cells.start)..][..channels * cells.len()];
                    let from = &column[channels * (3 * ky + skipped)..][..to.len()];
                    to.iter_mut().zip(from).for_each(|(t, f)| *t += f);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// The same convolution by its definition, cell by cell.
    #[test]
    fn convolutions_are_sums_over_nine_cells() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        // Wide enough that rows are worked on one after another.
        let grid = Grid { width: 700, height: 9 };
        let mut places = Places::default();
        let convolution = Convolution::new(&mut places, 6, 2);
        let mut numbers = places.draw(&mut rng);
        for n in &mut numbers {
            *n += 0.1;
        }
        let x = Matrix::from_fn(6, grid.cells(), |_, _| rng.random_range(-1.0..1.0));
        let y = convolution.forward(&numbers, grid, &x);
        for cell in (0..grid.cells()).step_by(37).chain([0, 699, grid.cells() - 1]) {
            for to in 0..2 {
                let mut sum = numbers[2 * 54 + to];
                for (k, (dy, dx)) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dy, dx))).enumerate() {
                    let (row, column) = ((cell / 700) as i64 + dy, (cell % 700) as i64 + dx);
                    if (0..9).contains(&row) && (0..700).contains(&column) {
                        let beside = (row * 700 + column) as usize;
                        sum += (0..6).map(|c| numbers[2 * (6 * k + c) + to] * x[(c, beside)]).sum::<f32>();
                    }
                }
                assert!((y[(to, cell)] - sum).abs() < 1e-4, "{cell} {to}: {} {sum}", y[(to, cell)]);
            }
        }
    }
}
