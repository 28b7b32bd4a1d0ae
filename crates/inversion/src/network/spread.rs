//! Mean and standard deviation of the outputs of a layer over examples, by which training begins.

use veiloc_training::layers::Linear;

/// Sums over columns.
pub(super) struct Spread {
    count: f64,
    sums: Vec<f64>,
    squares: Vec<f64>,
}

impl Spread {
    /// Of columns of so many numbers, none yet.
    pub(super) fn new(channels: usize) -> Self {
        Self { count: 0.0, sums: vec![0.0; channels], squares: vec![0.0; channels] }
    }

    pub(super) fn add(&mut self, column: &[f32]) {
        self.count += 1.0;
        for (number, (sum, square)) in column.iter().zip(self.sums.iter_mut().zip(&mut self.squares)) {
            *sum += f64::from(*number);
            *square += f64::from(*number).powi(2);
        }
    }

    /// Means and standard deviations.
    pub(super) fn of_each(&self) -> (Vec<f32>, Vec<f32>) {
        let of = |(sum, square): (&f64, &f64)| {
            let mean = sum / self.count;
            (mean as f32, (square / self.count - mean * mean).max(0.0).sqrt() as f32)
        };
        self.sums.iter().zip(&self.squares).map(of).unzip()
    }

    /// Makes the layer whose outputs these were begin with mean 0 and variance 1. Of no column nothing is known.
    pub(super) fn standardize(&self, layer: &Linear, numbers: &mut [f32]) {
        if self.count > 0.0 {
            let (mean, deviation) = self.of_each();
            layer.standardize(numbers, &mean, &deviation);
        }
    }
}
