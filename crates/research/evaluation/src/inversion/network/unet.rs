//! One U-Net from descriptors to colours, forward and back.

use veiloc_attacks::training::Matrix;
use veiloc_attacks::training::layers::{Linear, Places};

use super::front::{Front, MORE};
use super::levels::{Levels, LevelsTape};
use super::sampling::{rectify, rectify_back};
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

    /// `[3, cells]`, colours, mostly from 0 to 1.
    pub(crate) fn forward(&self, numbers: &[f32], placed: &Placed) -> (Matrix, Tape) {
        let (x, full) = self.front.forward(numbers, placed);
        let bag = self.bag.as_ref().filter(|_| placed.descriptors.ncols() > 0).map(|[each, all]| {
            let mut own = each.forward(numbers, &placed.descriptors);
            rectify(&mut own);
            let mean = Matrix::from_column_slice(own.nrows(), 1, own.column_mean().as_slice());
            (all.forward(numbers, &mean), BagTape { each: own, mean })
        });
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
