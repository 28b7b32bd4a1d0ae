//! The levels of a U-Net, down to coarse grids and up again, forward and back: what every network here is built of.

use veiloc_attacks::training::Matrix;
use veiloc_attacks::training::layers::{Linear, Places};

use super::Grid;
use super::convolution::Convolution;
use super::sampling::{enlarged_back, enlarged_beside, pooled, pooled_back, rectify, rectify_back};

/// The layers, by where their numbers stand.
#[derive(Debug, Clone)]
pub(super) struct Levels {
    width: usize,
    /// By level, the finest first.
    down: Vec<Pair>,
    /// By level, all but the coarsest.
    up: Vec<(Linear, Pair)>,
    last: Linear,
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
pub(super) struct LevelsTape {
    down: Vec<PairTape>,
    /// By level: what came into the matrix, and the pair.
    up: Vec<(Matrix, PairTape)>,
}

/// What comes out of the way back.
pub(super) struct LevelsBack {
    /// Of what came in, `[from, cells]`.
    pub(super) input: Matrix,
    /// Of the column that was added at the coarsest level.
    pub(super) told: Matrix,
}

impl Levels {
    /// From so many channels to so many; `width` of them on the finest level, twice as many on each of the `depth` − 1 others.
    pub(super) fn new(places: &mut Places, [from, to]: [usize; 2], width: usize, depth: usize) -> Self {
        let channels = |level: usize| width << level;
        let down = (0..depth).map(|level| {
            let from = if level == 0 { from } else { channels(level - 1) };
            Pair::new(places, from, channels(level))
        });
        let down = down.collect();
        let up = (0..depth - 1).map(|level| {
            let narrow = places.linear(channels(level + 1), channels(level));
            (narrow, Pair::new(places, 2 * channels(level), channels(level)))
        });
        let up = up.collect();
        Self { width, down, up, last: places.linear(width, to) }
    }

    /// Channels of the coarsest level.
    pub(super) fn deepest(&self) -> usize {
        self.width << (self.down.len() - 1)
    }

    /// `[from, cells]` → `[to, cells]`. `told`: a column that is added to every cell of the coarsest level.
    pub(super) fn forward(
        &self,
        numbers: &[f32],
        finest: Grid,
        mut x: Matrix,
        told: Option<&Matrix>,
    ) -> (Matrix, LevelsTape) {
        let mut down: Vec<PairTape> = Vec::new();
        for (level, pair) in self.down.iter().enumerate() {
            if level > 0 {
                x = pooled(level_grid(finest, level - 1), &x);
            }
            let tape = pair.forward(numbers, level_grid(finest, level), x);
            x = tape.output.clone();
            down.push(tape);
        }
        if let Some(told) = told {
            x.column_iter_mut().for_each(|mut column| column += told.column(0));
        }
        let mut up = Vec::new();
        for level in (0..self.up.len()).rev() {
            let grid = level_grid(finest, level);
            let (narrow, pair) = &self.up[level];
            let small = narrow.forward(numbers, &x);
            let tape = pair.forward(numbers, grid, enlarged_beside(grid, &small, &down[level].output));
            up.push((x, tape));
            x = up[up.len() - 1].1.output.clone();
        }
        let out = self.last.forward(numbers, &x);
        up.reverse();
        (out, LevelsTape { down, up })
    }

    /// Adds to the derivatives of its numbers, from those of what went out.
    pub(super) fn backward(
        &self,
        numbers: &[f32],
        slopes: &mut [f32],
        finest: Grid,
        tape: &LevelsTape,
        dy: &Matrix,
    ) -> LevelsBack {
        let before = tape.up.first().map_or(&tape.down[0].output, |(_, pair)| &pair.output);
        let mut d = self.last.backward(numbers, slopes, before, dy);
        // What flows into each level's own channels on the way up.
        let mut aside = Vec::new();
        for (level, (narrow, pair)) in self.up.iter().enumerate() {
            let grid = level_grid(finest, level);
            let (came, own) = &tape.up[level];
            let both = pair.backward(numbers, slopes, grid, own, d);
            let (small, beside) = enlarged_back(grid, self.width << level, &both);
            aside.push(beside);
            d = narrow.backward(numbers, slopes, came, &small);
        }
        let told = Matrix::from_column_slice(d.nrows(), 1, d.column_sum().as_slice());
        for level in (0..self.down.len()).rev() {
            let grid = level_grid(finest, level);
            if level < aside.len() {
                let mut larger = std::mem::replace(&mut aside[level], Matrix::zeros(0, 0));
                pooled_back(grid, &tape.down[level].output, &d, &mut larger);
                d = larger;
            }
            d = self.down[level].backward(numbers, slopes, grid, &tape.down[level], d);
        }
        LevelsBack { input: d, told }
    }
}

fn level_grid(grid: Grid, level: usize) -> Grid {
    Grid { width: grid.width >> level, height: grid.height >> level }
}
