//! The layers in their order, forward and back.

use veiloc_training::Matrix;
use veiloc_training::layers::{Linear, Places};

use super::convolution::Convolution;
use super::sampling::{enlarged_back, enlarged_beside, pooled, pooled_back, rectify, rectify_back};
use super::{Grid, Placed, Sees, Shape};

/// Numbers a cell is told by beside descriptors: how full it is, and where it is.
const MORE: usize = 3;
/// Red, green and blue.
const COLOURS: usize = 3;

/// The layers, by where their numbers stand.
#[derive(Debug, Clone)]
pub(crate) struct UNet {
    shape: Shape,
    first: Linear,
    /// By level, the finest first.
    down: Vec<Pair>,
    /// By level, all but the coarsest.
    up: Vec<(Linear, Pair)>,
    last: Linear,
    /// What is told of all descriptors together.
    bag: Option<[Linear; 2]>,
}

/// Two convolutions, each rectified.
#[derive(Debug, Clone, Copy)]
struct Pair([Convolution; 2]);

/// What the way back through a pair needs.
#[derive(Debug)]
struct PairTape {
    input: Matrix,
    middle: Matrix,
    output: Matrix,
}

impl Pair {
    fn new(places: &mut Places, from: usize, to: usize) -> Self {
        Self([Convolution::new(places, from, to), Convolution::new(places, to, to)])
    }

    fn forward(&self, numbers: &[f32], grid: Grid, input: Matrix) -> PairTape {
        let mut middle = self.0[0].forward(numbers, grid, &input);
        rectify(&mut middle);
        let mut output = self.0[1].forward(numbers, grid, &middle);
        rectify(&mut output);
        PairTape { input, middle, output }
    }

    fn backward(
        &self,
        numbers: &[f32],
        slopes: &mut [f32],
        grid: Grid,
        tape: &PairTape,
        mut dy: Matrix,
    ) -> Matrix {
        rectify_back(&tape.output, &mut dy);
        let mut d = self.0[1].backward(numbers, slopes, grid, &tape.middle, &dy);
        rectify_back(&tape.middle, &mut d);
        self.0[0].backward(numbers, slopes, grid, &tape.input, &d)
    }
}

/// What the way back needs.
#[derive(Debug)]
pub(crate) struct Tape {
    /// By cell, how full it is.
    full: Vec<f32>,
    down: Vec<PairTape>,
    /// By level: what came into the matrix, and the pair.
    up: Vec<(Matrix, PairTape)>,
    bag: Option<BagTape>,
}

#[derive(Debug)]
struct BagTape {
    /// `[channels, N]`, rectified.
    each: Matrix,
    /// `[channels, 1]`.
    mean: Matrix,
}

impl UNet {
    pub(crate) fn new(shape: Shape) -> (Self, Places) {
        let mut places = Places::default();
        let first = places.linear(shape.dimension, shape.width);
        let channels = |level: usize| shape.channels(level);
        let down = (0..shape.depth).map(|level| {
            let from = if level == 0 { shape.width + MORE } else { channels(level - 1) };
            Pair::new(&mut places, from, channels(level))
        });
        let down = down.collect();
        let up = (0..shape.depth - 1).map(|level| {
            let narrow = places.linear(channels(level + 1), channels(level));
            (narrow, Pair::new(&mut places, 2 * channels(level), channels(level)))
        });
        let up = up.collect();
        let last = places.linear(shape.width, COLOURS);
        let bag = (shape.sees == Sees::Bag).then(|| {
            let deep = channels(shape.depth - 1);
            [places.linear(shape.dimension, 2 * deep), places.linear(2 * deep, deep)]
        });
        (Self { shape, first, down, up, last, bag }, places)
    }

    pub(crate) fn shape(&self) -> &Shape {
        &self.shape
    }

    /// What stands on the grid: `[width + MORE, cells]`, and how full each cell is.
    fn placed(&self, numbers: &[f32], placed: &Placed) -> (Matrix, Vec<f32>) {
        let grid = placed.grid;
        let width = self.shape.width;
        let short = self.first.forward(numbers, &placed.descriptors);
        let mut full = vec![0.0f32; grid.cells()];
        placed.shares.iter().for_each(|(_, cell, share)| full[*cell as usize] += share);
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

    /// `[3, cells]`, colours, mostly from 0 to 1.
    pub(crate) fn forward(&self, numbers: &[f32], placed: &Placed) -> (Matrix, Tape) {
        let (mut x, full) = self.placed(numbers, placed);
        let mut grid = placed.grid;
        let mut down: Vec<PairTape> = Vec::new();
        for (level, pair) in self.down.iter().enumerate() {
            if level > 0 {
                x = pooled(grid, &x);
                grid = grid.half();
            }
            let tape = pair.forward(numbers, grid, x);
            x = tape.output.clone();
            down.push(tape);
        }
        let bag = self.bag.as_ref().filter(|_| placed.descriptors.ncols() > 0).map(|[each, all]| {
            let mut own = each.forward(numbers, &placed.descriptors);
            rectify(&mut own);
            let mean = Matrix::from_column_slice(own.nrows(), 1, own.column_mean().as_slice());
            let told = all.forward(numbers, &mean);
            x.column_iter_mut().for_each(|mut column| column += told.column(0));
            BagTape { each: own, mean }
        });
        let mut up = Vec::new();
        for level in (0..self.up.len()).rev() {
            let grid = level_grid(placed.grid, level);
            let (narrow, pair) = &self.up[level];
            let small = narrow.forward(numbers, &x);
            let tape = pair.forward(numbers, grid, enlarged_beside(grid, &small, &down[level].output));
            up.push((x, tape));
            x = up[up.len() - 1].1.output.clone();
        }
        let colours = self.last.forward(numbers, &x);
        up.reverse();
        (colours, Tape { full, down, up, bag })
    }

    /// Adds to the derivatives of all numbers, from those of the colours.
    pub(crate) fn backward(
        &self,
        numbers: &[f32],
        slopes: &mut [f32],
        placed: &Placed,
        tape: &Tape,
        of_colours: &Matrix,
    ) {
        let finest = tape.up.first().map_or(&tape.down[0].output, |(_, pair)| &pair.output);
        let mut d = self.last.backward(numbers, slopes, finest, of_colours);
        // What flows into each level's own channels on the way up.
        let mut aside = Vec::new();
        for (level, (narrow, pair)) in self.up.iter().enumerate() {
            let grid = level_grid(placed.grid, level);
            let (came, own) = &tape.up[level];
            let both = pair.backward(numbers, slopes, grid, own, d);
            let (small, beside) = enlarged_back(grid, self.shape.channels(level), &both);
            aside.push(beside);
            d = narrow.backward(numbers, slopes, came, &small);
        }
        if let (Some([each, all]), Some(bag)) = (&self.bag, &tape.bag) {
            let told = Matrix::from_column_slice(d.nrows(), 1, d.column_sum().as_slice());
            let of_mean = all.backward(numbers, slopes, &bag.mean, &told);
            let share = 1.0 / bag.each.ncols() as f32;
            let mut of_each =
                Matrix::from_fn(bag.each.nrows(), bag.each.ncols(), |row, _| share * of_mean[row]);
            rectify_back(&bag.each, &mut of_each);
            each.learn(slopes, &placed.descriptors, &of_each);
        }
        for level in (0..self.down.len()).rev() {
            let grid = level_grid(placed.grid, level);
            if level < aside.len() {
                let mut larger = std::mem::replace(&mut aside[level], Matrix::zeros(0, 0));
                pooled_back(grid, &tape.down[level].output, &d, &mut larger);
                d = larger;
            }
            d = self.down[level].backward(numbers, slopes, grid, &tape.down[level], d);
        }
        self.placed_back(slopes, placed, &tape.full, &d);
    }

    fn placed_back(&self, slopes: &mut [f32], placed: &Placed, full: &[f32], d: &Matrix) {
        if placed.shares.is_empty() {
            return;
        }
        let width = self.shape.width;
        let mut short = Matrix::zeros(width, placed.descriptors.ncols());
        for (descriptor, cell, share) in &placed.shares {
            let share = share / full[*cell as usize].max(1.0);
            let from = &d.as_slice()[(width + MORE) * *cell as usize..][..width];
            let to = &mut short.as_mut_slice()[width * *descriptor as usize..][..width];
            to.iter_mut().zip(from).for_each(|(t, f)| *t += share * f);
        }
        self.first.learn(slopes, &placed.descriptors, &short);
    }
}

fn level_grid(grid: Grid, level: usize) -> Grid {
    Grid { width: grid.width >> level, height: grid.height >> level }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn placed(rng: &mut ChaCha8Rng, grid: Grid) -> Placed {
        let shares =
            (0..20).map(|i| (i % 9, rng.random_range(0..grid.cells() as u32), rng.random_range(0.2..1.0)));
        let shares = shares.collect();
        Placed { grid, descriptors: Matrix::from_fn(7, 9, |_, _| rng.random_range(-1.0..1.0)), shares }
    }

    /// The slope of a sum of colours along each number, by the way back and by differences.
    fn derivatives(sees: Sees, depth: usize, grid: Grid) {
        let mut rng = ChaCha8Rng::seed_from_u64(depth as u64);
        let shape = Shape { dimension: 7, width: 3, depth, side: 16, sees };
        let (net, places) = UNet::new(shape);
        let mut numbers = places.draw(&mut rng);
        // Biases too, and away from the kinks at zero.
        for n in &mut numbers {
            *n += rng.random_range(0.0..0.1);
        }
        let placed = placed(&mut rng, grid);
        let weights = Matrix::from_fn(3, grid.cells(), |_, _| rng.random_range(-1.0..1.0));
        let value = |numbers: &[f32]| -> f64 {
            let colours = net.forward(numbers, &placed).0;
            colours.iter().zip(weights.iter()).map(|(c, w)| f64::from(*c) * f64::from(*w)).sum()
        };
        let (_, tape) = net.forward(&numbers, &placed);
        let mut slopes = vec![0.0; numbers.len()];
        net.backward(&numbers, &mut slopes, &placed, &tape, &weights);
        let scale = slopes.iter().map(|s| s.abs()).fold(0.0, f32::max);
        let (mut far, mut steep) = (0, 0);
        for at in (0..numbers.len()).step_by(3) {
            let (here, step) = (numbers[at], 5e-4);
            numbers[at] = here + step;
            let after = value(&numbers);
            numbers[at] = here - step;
            let before = value(&numbers);
            numbers[at] = here;
            let numeric = ((after - before) / (2.0 * f64::from(step))) as f32;
            far += usize::from((numeric - slopes[at]).abs() > 0.02 * scale.min(numeric.abs() + 0.05 * scale));
            steep += usize::from(numeric.abs() > 0.01 * scale);
        }
        let count = numbers.len().div_ceil(3);
        // Where a step crosses the kink of a rectified channel, or another cell becomes the largest, differences err.
        assert!(far * 50 < count, "{sees:?} {depth}: {far} of {count}");
        assert!(steep * 4 > count, "{sees:?} {depth}: hardly anything has a slope, {steep} of {count}");
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        derivatives(Sees::Places, 1, Grid { width: 5, height: 3 });
        derivatives(Sees::Places, 2, Grid { width: 6, height: 4 });
        derivatives(Sees::Places, 3, Grid { width: 8, height: 12 });
        derivatives(Sees::Bag, 2, Grid { width: 6, height: 4 });
    }

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

    #[test]
    fn descriptors_in_one_cell_are_averaged_and_their_order_is_nothing() {
        let grid = Grid { width: 4, height: 4 };
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (net, places) =
            UNet::new(Shape { dimension: 2, width: 3, depth: 2, side: 16, sees: Sees::Places });
        let numbers = places.draw(&mut rng);
        let of = |descriptors: &[f32], shares: Vec<(u32, u32, f32)>| {
            let descriptors = Matrix::from_column_slice(2, descriptors.len() / 2, descriptors);
            net.placed(&numbers, &Placed { grid, descriptors, shares }).0
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
