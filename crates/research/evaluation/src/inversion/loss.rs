//! What training makes small: differences of colours, and of their changes from cell to cell at three scales.
//!
//! ```text
//! loss = mean |o − t| + mean over scales of (mean |∂x (o − t)| + mean |∂y (o − t)|)
//! ```
//!
//! The second part stands where the literature has a distance of VGG's features: no such network is at hand, and a network that
//! judges results had better not have taught them. Changes from cell to cell are what such features begin with. Both parts are
//! functions of the difference alone, so that one pass gives the derivatives.

use veiloc_attacks::training::Matrix;

use crate::inversion::network::{Grid, Made, Placed, Stages};

/// What a wrong belief costs beside colours that are off.
const OF_BELIEF: f32 = 1.0;

/// Scales at which changes count, each of half the sides of the one before.
const SCALES: usize = 3;

/// The loss of what a network made, and its derivatives: that of the colours, and of earlier stages that of the first image and
/// of what they believe. `right`, `[N]`: which descriptors stand where they belong.
pub(crate) fn loss_of(made: &Made, placed: &Placed, right: &[bool], truth: &Matrix) -> (f64, Made) {
    let (mut sum, colours) = loss(placed.grid, &made.colours, truth);
    let stages = made.stages.as_ref().map(|stages| {
        let (first, coarse) = loss(placed.grid, &stages.coarse, truth);
        let (wrong, odds) = belief(&stages.odds, placed, right);
        sum += first + f64::from(OF_BELIEF) * wrong;
        Stages { odds: odds * OF_BELIEF, coarse }
    });
    (sum, Made { colours, stages })
}

/// What beliefs cost, in natural logarithms, the mean over the cells in which something stands, and its derivatives. `odds`,
/// `[1, cells]`: their logarithms. Of what shares a cell the share that belongs there is to be believed.
fn belief(odds: &Matrix, placed: &Placed, right: &[bool]) -> (f64, Matrix) {
    let full = placed.full();
    let mut belongs = vec![0.0f32; full.len()];
    for (descriptor, cell, share) in &placed.shares {
        belongs[*cell as usize] += if right[*descriptor as usize] { *share } else { 0.0 };
    }
    let share = 1.0 / full.iter().filter(|full| **full > 0.0).count().max(1) as f32;
    let (mut sum, mut slopes) = (0.0, Matrix::zeros(1, full.len()));
    for (cell, full) in full.iter().enumerate().filter(|(_, full)| **full > 0.0) {
        let (z, truth) = (odds[cell], belongs[cell] / full);
        // −truth ln b − (1 − truth) ln (1 − b) with b = 1 / (1 + exp(−z)), without ever taking the logarithm of nothing.
        sum += f64::from(share * (z.max(0.0) - truth * z + (-z.abs()).exp().ln_1p()));
        slopes[cell] = share * (1.0 / (1.0 + (-z).exp()) - truth);
    }
    (sum, slopes)
}

/// The loss of these colours, `[3, cells]` both, and its derivatives.
fn loss(grid: Grid, colours: &Matrix, truth: &Matrix) -> (f64, Matrix) {
    let difference = colours - truth;
    let share = 1.0 / difference.len() as f32;
    let mut slopes = difference.map(|d| share * sign(d));
    let mut sum = f64::from(share) * difference.iter().map(|d| f64::from(d.abs())).sum::<f64>();
    let scales = (1..SCALES)
        .take_while(|s| [grid.width, grid.height].iter().all(|side| side.is_multiple_of(1 << s)))
        .count()
        + 1;
    changes(grid, &difference, scales, 1.0 / scales as f32, &mut sum, &mut slopes);
    (sum, slopes)
}

/// Adds what changes cost at this scale and coarser ones.
fn changes(grid: Grid, map: &Matrix, scales: usize, weight: f32, sum: &mut f64, slopes: &mut Matrix) {
    let channels = map.nrows();
    let mut along = |pairs: &mut dyn Iterator<Item = (usize, usize)>, count: usize| {
        let share = weight / (count * channels).max(1) as f32;
        for (a, b) in pairs {
            for channel in 0..channels {
                let change = map[(channel, b)] - map[(channel, a)];
                *sum += f64::from(share * change.abs());
                slopes[(channel, b)] += share * sign(change);
                slopes[(channel, a)] -= share * sign(change);
            }
        }
    };
    let Grid { width, height } = grid;
    let across = (0..grid.cells()).filter(|cell| cell % width + 1 < width).map(|cell| (cell, cell + 1));
    along(&mut { across }, height * (width - 1));
    along(&mut (0..grid.cells() - width).map(|cell| (cell, cell + width)), width * (height - 1));
    if scales > 1 {
        let half = Grid { width: width / 2, height: height / 2 };
        let of = |cell: usize| (cell / width / 2) * half.width + cell % width / 2;
        let mut small = Matrix::zeros(channels, half.cells());
        for (cell, column) in map.column_iter().enumerate() {
            small.column_mut(of(cell)).axpy(0.25, &column, 1.0);
        }
        let mut of_small = Matrix::zeros(channels, half.cells());
        changes(half, &small, scales - 1, weight, sum, &mut of_small);
        for (cell, mut column) in slopes.column_iter_mut().enumerate() {
            column.axpy(0.25, &of_small.column(of(cell)), 1.0);
        }
    }
}

fn sign(x: f32) -> f32 {
    if x > 0.0 {
        1.0
    } else if x < 0.0 {
        -1.0
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn equal_colours_cost_nothing_and_an_even_difference_only_itself() {
        let grid = Grid { width: 8, height: 4 };
        let truth = Matrix::from_fn(3, 32, |row, column| (row + column) as f32 / 40.0);
        assert_eq!(loss(grid, &truth, &truth).0, 0.0);
        let brighter = truth.map(|t| t + 0.25);
        assert!((loss(grid, &brighter, &truth).0 - 0.25).abs() < 1e-6);
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for grid in [Grid { width: 8, height: 4 }, Grid { width: 3, height: 5 }] {
            let truth = Matrix::from_fn(3, grid.cells(), |_, _| rng.random_range(0.0..1.0));
            let mut colours = Matrix::from_fn(3, grid.cells(), |_, _| rng.random_range(0.0..1.0));
            let (_, slopes) = loss(grid, &colours, &truth);
            for at in 0..colours.len() {
                let (step, here) = (1e-4, colours[at]);
                colours[at] = here + step;
                let after = loss(grid, &colours, &truth).0;
                colours[at] = here - step;
                let before = loss(grid, &colours, &truth).0;
                colours[at] = here;
                let numeric = (after - before) / (2.0 * f64::from(step));
                assert!(
                    (numeric - f64::from(slopes[at])).abs() < 2e-3,
                    "{grid:?} {at}: {numeric} {}",
                    slopes[at]
                );
            }
        }
    }

    #[test]
    fn a_belief_costs_what_it_is_off() {
        let grid = Grid { width: 4, height: 1 };
        let descriptors = Matrix::zeros(2, 3);
        // One that belongs to cell 0, one that does not to cell 1, and both kinds in cell 2; nothing in cell 3.
        let shares = vec![(0, 0, 1.0), (1, 1, 1.0), (0, 2, 1.0), (2, 2, 1.0)];
        let placed = Placed { grid, descriptors, shares };
        let right = [true, false, false];
        let of = |odds: [f32; 4]| belief(&Matrix::from_row_slice(1, 4, &odds), &placed, &right);
        let (even, _) = of([0.0; 4]);
        assert!((even - 2.0f64.ln()).abs() < 1e-6, "{even}");
        let (known, slopes) = of([20.0, -20.0, 0.0, 7.0]);
        assert!((known - 2.0f64.ln() / 3.0).abs() < 1e-6, "{known}: one cell cannot be told");
        assert!(slopes.iter().all(|slope| slope.abs() < 1e-6), "{slopes}");
        assert!(of([-200.0, 200.0, 0.0, 0.0]).0.is_finite(), "as wrong as can be");
        let odds = [0.3, -0.7, 1.1, 0.2];
        let (_, slopes) = of(odds);
        for cell in 0..4 {
            let moved = |by: f32| {
                let mut odds = odds;
                odds[cell] += by;
                of(odds).0
            };
            let numeric = (moved(1e-2) - moved(-1e-2)) / 2e-2;
            assert!((numeric - f64::from(slopes[cell])).abs() < 1e-4, "{cell}: {numeric} {}", slopes[cell]);
        }
    }
}
