//! One U-Net from descriptors to colours, forward and back.

use veiloc_training::Matrix;
use veiloc_training::layers::{Linear, Places};

use super::front::{Front, MORE};
use super::levels::{Levels, LevelsTape};
use super::sampling::{rectify, rectify_back};
use super::spread::Spread;
use super::{COLOURS, Placed, Sees, Shape};

/// The layers, by where their numbers stand.
#[derive(Debug, Clone)]
pub(crate) struct UNet {
    front: Front,
    levels: Levels,
    /// What is told of all descriptors together.
    bag: Option<[Linear; 2]>,
}

/// What the way back needs.
#[derive(Debug)]
pub(crate) struct Tape {
    /// By cell, how full it is.
    full: Vec<f32>,
    levels: LevelsTape,
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
        let front = Front::new(&mut places, shape.dimension, shape.width);
        let levels = Levels::new(&mut places, [shape.width + MORE, COLOURS], shape.width, shape.depth);
        let bag = (shape.sees == Sees::Bag).then(|| {
            let deep = levels.deepest();
            [places.linear(shape.dimension, 2 * deep), places.linear(2 * deep, deep)]
        });
        (Self { front, levels, bag }, places)
    }

    /// Sets what is told of cells, and of all descriptors together, to mean 0 and variance 1 over these examples: the mean of a
    /// thousand descriptors is nearly the same for every image.
    pub(crate) fn begin(&self, numbers: &mut [f32], examples: &[Placed]) {
        self.front.begin(numbers, examples);
        if let Some(bag @ [_, all]) = &self.bag {
            let mut seen = Spread::new(self.levels.deepest());
            for told in examples.iter().filter_map(|placed| told_of(bag, numbers, placed)) {
                seen.add(told.0.as_slice());
            }
            seen.standardize(all, numbers);
        }
    }

    /// `[3, cells]`, colours, mostly from 0 to 1.
    pub(crate) fn forward(&self, numbers: &[f32], placed: &Placed) -> (Matrix, Tape) {
        let (x, full) = self.front.forward(numbers, placed);
        let bag = self.bag.as_ref().and_then(|bag| told_of(bag, numbers, placed));
        let told = bag.as_ref().map(|(told, _)| told);
        let (colours, levels) = self.levels.forward(numbers, placed.grid, x, told);
        (colours, Tape { full, levels, bag: bag.map(|(_, tape)| tape) })
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
        let back = self.levels.backward(numbers, slopes, placed.grid, &tape.levels, of_colours);
        if let (Some([each, all]), Some(bag)) = (&self.bag, &tape.bag) {
            let of_mean = all.backward(numbers, slopes, &bag.mean, &back.told);
            let share = 1.0 / bag.each.ncols() as f32;
            let mut of_each =
                Matrix::from_fn(bag.each.nrows(), bag.each.ncols(), |row, _| share * of_mean[row]);
            rectify_back(&bag.each, &mut of_each);
            each.learn(slopes, &placed.descriptors, &of_each);
        }
        self.front.learn(slopes, placed, &tape.full, &back.input);
    }
}

/// What is told of all descriptors together, `[channels, 1]`; nothing of none.
fn told_of([each, all]: &[Linear; 2], numbers: &[f32], placed: &Placed) -> Option<(Matrix, BagTape)> {
    (placed.descriptors.ncols() > 0).then(|| {
        let mut own = each.forward(numbers, &placed.descriptors);
        rectify(&mut own);
        let mean = Matrix::from_column_slice(own.nrows(), 1, own.column_mean().as_slice());
        (all.forward(numbers, &mean), BagTape { each: own, mean })
    })
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::super::{Form, Grid};
    use super::*;

    /// Bags that differ by a hundredth begin to tell images apart.
    #[test]
    fn what_is_told_of_a_bag_begins_with_mean_0_and_variance_1() {
        let shape = Shape { form: Form::UNet, dimension: 6, width: 3, depth: 2, side: 16, sees: Sees::Bag };
        let (net, places) = UNet::new(shape);
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let mut numbers = places.draw(&mut rng);
        let mut example = || {
            let own = rng.random_range(0.99..1.01);
            let descriptors = Matrix::from_fn(6, 100, |_, _| own * rng.random_range(0.8..1.2));
            Placed { grid: Grid { width: 4, height: 4 }, descriptors, shares: Vec::new() }
        };
        let examples: Vec<Placed> = (0..20).map(|_| example()).collect();
        net.begin(&mut numbers, &examples);
        let bag = net.bag.as_ref().expect("it has one");
        let mut seen = Spread::new(net.levels.deepest());
        for placed in &examples {
            seen.add(told_of(bag, &numbers, placed).expect("descriptors").0.as_slice());
        }
        let (mean, deviation) = seen.of_each();
        assert!(mean.iter().all(|mean| mean.abs() < 1e-2), "{mean:?}");
        assert!(deviation.iter().all(|deviation| (deviation - 1.0).abs() < 1e-2), "{deviation:?}");
    }
}
