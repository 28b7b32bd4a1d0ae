//! Three U-Nets in a row, after Pittaluga et al., *Revealing Scenes by Inverting Structure from Motion Reconstructions*, CVPR
//! 2019 (InvSfM), which the paper uses for SIFT.
//!
//! ```text
//! x = descriptors on the grid                                              [width + 3, cells]
//! belief = 1 / (1 + exp(−judge(x)))      of what stands in a cell          [1, cells]
//! y = x, but for where the cell is, times belief
//! coarse = colours of y                                                    [3, cells]
//! colours = coarse + what a third makes of coarse beside y                 [3, cells]
//! ```
//!
//! Their first stage, VisibNet, tells which of a map's projected points a camera sees. A query has no hidden points, but what
//! an attack puts onto the grid has wrong places, and these are hidden in the same way: **the first stage judges whether what
//! stands in a cell belongs there**, and learns it from descriptors that were put elsewhere on purpose. The other two are their
//! CoarseNet and RefineNet without depth and colours of points, which no query has.
//!
//! They train the stages one after another, the last with an adversary; here all three learn at once, each from its own loss,
//! and what later ones need flows back into earlier ones.

use veiloc_attacks::training::Matrix;
use veiloc_attacks::training::layers::Places;

use super::front::{Front, MORE};
use super::levels::{Levels, LevelsTape};
use super::{COLOURS, Made, Placed, Shape, Stages};

/// The layers, by where their numbers stand.
#[derive(Debug, Clone)]
pub(crate) struct InvSfm {
    width: usize,
    front: Front,
    /// To one number a cell.
    judge: Levels,
    coarse: Levels,
    refine: Levels,
}

/// What the way back needs.
#[derive(Debug)]
pub(crate) struct Tape {
    /// By cell, how full it is.
    full: Vec<f32>,
    /// What stands on the grid.
    x: Matrix,
    /// By cell, from 0 to 1.
    belief: Vec<f32>,
    judge: LevelsTape,
    coarse: LevelsTape,
    refine: LevelsTape,
}

impl InvSfm {
    pub(crate) fn new(shape: Shape) -> (Self, Places) {
        let Shape { dimension, width, depth, .. } = shape;
        let mut places = Places::default();
        let front = Front::new(&mut places, dimension, width);
        let given = width + MORE;
        let judge = Levels::new(&mut places, [given, 1], width, depth);
        let coarse = Levels::new(&mut places, [given, COLOURS], width, depth);
        let refine = Levels::new(&mut places, [COLOURS + given, COLOURS], width, depth);
        (Self { width, front, judge, coarse, refine }, places)
    }

    /// What all stages answer.
    pub(crate) fn forward(&self, numbers: &[f32], placed: &Placed) -> (Made, Tape) {
        let grid = placed.grid;
        let (x, full) = self.front.forward(numbers, placed);
        let (odds, judge) = self.judge.forward(numbers, grid, x.clone(), None);
        let belief: Vec<f32> = odds.iter().map(|z| 1.0 / (1.0 + (-z).exp())).collect();
        let mut y = x.clone();
        for (mut column, belief) in y.column_iter_mut().zip(&belief) {
            column.rows_mut(0, self.believed()).scale_mut(*belief);
        }
        let mut beside = Matrix::zeros(COLOURS + y.nrows(), y.ncols());
        beside.rows_mut(COLOURS, y.nrows()).copy_from(&y);
        let (rough, coarse) = self.coarse.forward(numbers, grid, y, None);
        beside.rows_mut(0, COLOURS).copy_from(&rough);
        let (rest, refine) = self.refine.forward(numbers, grid, beside, None);
        let colours = &rough + rest;
        let made = Made { colours, stages: Some(Stages { odds, coarse: rough }) };
        (made, Tape { full, x, belief, judge, coarse, refine })
    }

    /// Adds to the derivatives of all numbers, from those of what was answered.
    pub(crate) fn backward(
        &self,
        numbers: &[f32],
        slopes: &mut [f32],
        placed: &Placed,
        tape: &Tape,
        of: &Made,
    ) {
        let grid = placed.grid;
        let of_beside = self.refine.backward(numbers, slopes, grid, &tape.refine, &of.colours).input;
        let mut of_rough = of_beside.rows(0, COLOURS) + &of.colours;
        let mut of_odds = Matrix::zeros(1, grid.cells());
        if let Some(stages) = &of.stages {
            of_rough += &stages.coarse;
            of_odds += &stages.odds;
        }
        let mut d = self.coarse.backward(numbers, slopes, grid, &tape.coarse, &of_rough).input;
        d += of_beside.rows(COLOURS, d.nrows());
        for (cell, belief) in tape.belief.iter().enumerate() {
            let own = tape.x.column(cell);
            let mut column = d.column_mut(cell);
            let of_belief = own.rows(0, self.believed()).dot(&column.rows(0, self.believed()));
            of_odds[cell] += of_belief * belief * (1.0 - belief);
            column.rows_mut(0, self.believed()).scale_mut(*belief);
        }
        d += self.judge.backward(numbers, slopes, grid, &tape.judge, &of_odds).input;
        self.front.learn(slopes, placed, &tape.full, &d);
    }

    /// Channels that are worth what is believed: of descriptors, and how full a cell is; where it is needs no belief.
    fn believed(&self) -> usize {
        self.width + 1
    }
}
