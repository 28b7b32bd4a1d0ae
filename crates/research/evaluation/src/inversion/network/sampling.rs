//! From a grid to one of half its sides and back: the largest of four cells, and each cell four times.

use veiloc_attacks::training::Matrix;

use super::Grid;

/// The cells of a grid of even sides in fours, as they stand in memory: `[half cells]`, by the cell of the half grid.
fn fours(grid: Grid) -> impl Iterator<Item = [usize; 4]> {
    let half = grid.half();
    (0..half.cells()).map(move |cell| {
        let first = 2 * (cell / half.width) * grid.width + 2 * (cell % half.width);
        [first, first + 1, first + grid.width, first + grid.width + 1]
    })
}

/// The largest of each four cells, channel by channel: `[channels, cells]` → `[channels, cells / 4]`.
pub(super) fn pooled(grid: Grid, x: &Matrix) -> Matrix {
    let mut y = Matrix::zeros(x.nrows(), grid.half().cells());
    for (mut column, four) in y.column_iter_mut().zip(fours(grid)) {
        for channel in 0..x.nrows() {
            column[channel] = four.iter().map(|cell| x[(channel, *cell)]).fold(f32::NEG_INFINITY, f32::max);
        }
    }
    y
}

/// Derivatives of what came into [`pooled`], added to `dx`: they go to the first of the largest.
pub(super) fn pooled_back(grid: Grid, x: &Matrix, dy: &Matrix, dx: &mut Matrix) {
    for (column, four) in dy.column_iter().zip(fours(grid)) {
        for channel in 0..x.nrows() {
            let largest = four
                .iter()
                .copied()
                .reduce(|best, cell| if x[(channel, cell)] > x[(channel, best)] { cell } else { best });
            if let Some(cell) = largest {
                dx[(channel, cell)] += column[channel];
            }
        }
    }
}

/// Each cell four times, beside other channels of the larger grid: `[a, cells / 4]` and `[b, cells]` → `[a + b, cells]`.
pub(super) fn enlarged_beside(grid: Grid, small: &Matrix, beside: &Matrix) -> Matrix {
    let (a, b) = (small.nrows(), beside.nrows());
    let mut y = Matrix::zeros(a + b, grid.cells());
    for (column, four) in small.column_iter().zip(fours(grid)) {
        for cell in four {
            y.view_mut((0, cell), (a, 1)).copy_from(&column);
        }
    }
    y.rows_mut(a, b).copy_from(beside);
    y
}

/// Derivatives of what came into [`enlarged_beside`]: of the small grid's cells, and of the other channels.
pub(super) fn enlarged_back(grid: Grid, a: usize, dy: &Matrix) -> (Matrix, Matrix) {
    let mut small = Matrix::zeros(a, grid.half().cells());
    for (mut column, four) in small.column_iter_mut().zip(fours(grid)) {
        for cell in four {
            column += dy.view((0, cell), (a, 1));
        }
    }
    (small, dy.rows(a, dy.nrows() - a).into_owned())
}

/// What is left of a negative number: with nothing left, narrow networks lose channels that never come back.
const LEFT: f32 = 0.1;

/// What is negative becomes a tenth of itself.
pub(super) fn rectify(x: &mut Matrix) {
    x.as_mut_slice().iter_mut().for_each(|v| *v = v.max(LEFT * *v));
}

/// Derivatives of what came in, from what went out.
pub(super) fn rectify_back(y: &Matrix, dy: &mut Matrix) {
    dy.as_mut_slice().iter_mut().zip(y.as_slice()).for_each(|(d, y)| {
        if *y <= 0.0 {
            *d *= LEFT;
        }
    });
}
