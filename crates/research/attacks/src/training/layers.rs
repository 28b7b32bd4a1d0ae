//! The simple layers: a matrix with a bias, and the norm. Each knows where its numbers stand in the list of all.

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::nalgebra::{DMatrixView, DMatrixViewMut};

use crate::training::Matrix;

/// Added to the variance, so that a column without any is not divided by nothing.
const FLOOR: f32 = 1e-5;

/// Gives each layer its place, one after another.
#[derive(Debug, Default)]
pub struct Places {
    used: usize,
    /// `[layers]`: where matrices stand, which are drawn at the start, and their inputs and outputs.
    matrices: Vec<Linear>,
    /// Where numbers stand that begin at one.
    ones: Vec<(usize, usize)>,
}

impl Places {
    /// A matrix with a bias.
    pub fn linear(&mut self, from: usize, to: usize) -> Linear {
        let layer = Linear { at: self.used, from, to };
        self.used += (from + 1) * to;
        self.matrices.push(layer);
        layer
    }

    /// A norm.
    pub fn norm(&mut self, width: usize) -> Norm {
        let layer = Norm { at: self.used, width };
        self.used += 2 * width;
        self.ones.push((layer.at, width));
        layer
    }

    /// A single number.
    pub fn number(&mut self) -> usize {
        self.used += 1;
        self.used - 1
    }

    /// How many numbers there are.
    pub fn count(&self) -> usize {
        self.used
    }

    /// Matrices drawn evenly within `±√(6 / (inputs + outputs))` (Glorot), biases zero, norms neutral.
    pub fn draw(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let mut numbers = vec![0.0; self.used];
        for layer in &self.matrices {
            let bound = (6.0 / (layer.from + layer.to) as f32).sqrt();
            numbers[layer.weights()].iter_mut().for_each(|w| *w = rng.random_range(-bound..bound));
        }
        for (at, count) in &self.ones {
            numbers[*at..at + count].fill(1.0);
        }
        numbers
    }

    /// Which numbers are entries of matrices, and so decay.
    pub fn decaying(&self) -> Vec<bool> {
        let mut decays = vec![false; self.used];
        self.matrices.iter().for_each(|layer| decays[layer.weights()].fill(true));
        decays
    }
}

/// `y = W x + b`.
#[derive(Debug, Clone, Copy)]
pub struct Linear {
    at: usize,
    from: usize,
    to: usize,
}

impl Linear {
    /// Where its matrix stands: column after column, a column an input.
    pub fn weights(&self) -> std::ops::Range<usize> {
        self.at..self.at + self.from * self.to
    }

    fn matrix<'a>(&self, numbers: &'a [f32]) -> DMatrixView<'a, f32> {
        DMatrixView::from_slice(&numbers[self.weights()], self.to, self.from)
    }

    /// `[from, N]` → `[to, N]`.
    pub fn forward(&self, numbers: &[f32], x: &Matrix) -> Matrix {
        let end = self.weights().end;
        let bias = &numbers[end..end + self.to];
        let mut y = Matrix::zeros(self.to, x.ncols());
        y.as_mut_slice().chunks_exact_mut(self.to).for_each(|column| column.copy_from_slice(bias));
        y.gemm(1.0, &self.matrix(numbers), x, 1.0);
        y
    }

    /// Adds to the derivatives of its numbers, from what came in and the derivatives of what went out.
    pub fn learn(&self, slopes: &mut [f32], x: &Matrix, dy: &Matrix) {
        let (weights, rest) = slopes[self.at..].split_at_mut(self.from * self.to);
        DMatrixViewMut::from_slice(weights, self.to, self.from).gemm(1.0, dy, &x.transpose(), 1.0);
        for column in dy.as_slice().chunks_exact(self.to) {
            rest.iter_mut().zip(column).for_each(|(s, d)| *s += d);
        }
    }

    /// [`Self::learn`], and the derivatives of what came in.
    pub fn backward(&self, numbers: &[f32], slopes: &mut [f32], x: &Matrix, dy: &Matrix) -> Matrix {
        self.learn(slopes, x, dy);
        // Transposed beforehand: a plain product of matrices is blocked, one with a transpose is not.
        self.matrix(numbers).transpose() * dy
    }
}

/// Each column with mean 0 and variance 1, then stretched and moved by what was learned.
#[derive(Debug, Clone, Copy)]
pub struct Norm {
    at: usize,
    width: usize,
}

/// What the way back through a norm needs.
#[derive(Debug)]
pub struct Normed {
    /// Columns of mean 0 and variance 1.
    columns: Matrix,
    /// By column, what it was divided by, inverted.
    inverse: Vec<f32>,
}

impl Norm {
    fn numbers<'a>(&self, numbers: &'a [f32]) -> (&'a [f32], &'a [f32]) {
        numbers[self.at..self.at + 2 * self.width].split_at(self.width)
    }

    /// What goes out, and what the way back needs.
    pub fn forward(&self, numbers: &[f32], x: &Matrix) -> (Matrix, Normed) {
        let (gain, shift) = self.numbers(numbers);
        let count = self.width as f32;
        let mut columns = x.clone();
        let mut y = Matrix::zeros(self.width, x.ncols());
        let mut inverse = Vec::with_capacity(x.ncols());
        let pairs = columns.as_mut_slice().chunks_exact_mut(self.width);
        for (column, out) in pairs.zip(y.as_mut_slice().chunks_exact_mut(self.width)) {
            let mean = column.iter().sum::<f32>() / count;
            for v in column.iter_mut() {
                *v -= mean;
            }
            let variance = column.iter().map(|v| v * v).sum::<f32>() / count;
            let factor = 1.0 / (variance + FLOOR).sqrt();
            for v in column.iter_mut() {
                *v *= factor;
            }
            inverse.push(factor);
            for (o, ((v, g), s)) in out.iter_mut().zip(column.iter().zip(gain).zip(shift)) {
                *o = v * g + s;
            }
        }
        (y, Normed { columns, inverse })
    }

    /// Adds to the derivatives of its numbers and returns those of what came in.
    pub fn backward(&self, numbers: &[f32], slopes: &mut [f32], normed: &Normed, mut dy: Matrix) -> Matrix {
        let (gain, _) = self.numbers(numbers);
        let (gains, shifts) = slopes[self.at..self.at + 2 * self.width].split_at_mut(self.width);
        let count = self.width as f32;
        let columns = normed.columns.as_slice().chunks_exact(self.width).zip(&normed.inverse);
        for (d, (column, inverse)) in dy.as_mut_slice().chunks_exact_mut(self.width).zip(columns) {
            let (mut sum, mut along) = (0.0, 0.0);
            for i in 0..self.width {
                gains[i] += d[i] * column[i];
                shifts[i] += d[i];
                d[i] *= gain[i];
                sum += d[i];
                along += d[i] * column[i];
            }
            let (mean, along) = (sum / count, along / count);
            d.iter_mut().zip(column).for_each(|(d, v)| *d = inverse * (*d - mean - along * v));
        }
        dy
    }
}
