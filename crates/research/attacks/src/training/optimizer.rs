//! AdamW: steps by the mean slope over its spread, with matrices that decay.
//!
//! Loshchilov and Hutter, *Decoupled Weight Decay Regularization*, ICLR 2019.

/// How much of the running means of slopes and of their squares is kept from step to step.
const KEPT: [f64; 2] = [0.9, 0.99];
const FLOOR: f32 = 1e-8;
/// Slopes longer than this, all numbers taken together, are made shorter.
const LONGEST: f64 = 1.0;

/// What the optimizer remembers. `[parameters]` each.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Memory {
    /// Running mean of the slopes.
    pub(crate) mean: Vec<f32>,
    /// Running mean of their squares.
    pub(crate) square: Vec<f32>,
}

impl Memory {
    pub(crate) fn new(parameters: usize) -> Self {
        Self { mean: vec![0.0; parameters], square: vec![0.0; parameters] }
    }

    /// One step: `numbers` moved against the `slopes`. `done` steps came before.
    pub(crate) fn step(
        &mut self,
        numbers: &mut [f32],
        slopes: &mut [f32],
        decays: &[bool],
        (rate, decay): (f64, f64),
        done: usize,
    ) {
        let length = slopes.iter().map(|s| f64::from(*s).powi(2)).sum::<f64>().sqrt();
        if length > LONGEST {
            let factor = (LONGEST / length) as f32;
            for s in slopes.iter_mut() {
                *s *= factor;
            }
        }
        let after = done as i32 + 1;
        let whole = KEPT.map(|kept| (1.0 / (1.0 - kept.powi(after))) as f32);
        let [a, b] = KEPT.map(|kept| kept as f32);
        let (rate, shrink) = (rate as f32, (1.0 - rate * decay) as f32);
        for i in 0..numbers.len() {
            let slope = slopes[i];
            self.mean[i] = a * self.mean[i] + (1.0 - a) * slope;
            self.square[i] = b * self.square[i] + (1.0 - b) * slope * slope;
            let kept = if decays[i] { shrink * numbers[i] } else { numbers[i] };
            numbers[i] =
                kept - rate * (self.mean[i] * whole[0]) / ((self.square[i] * whole[1]).sqrt() + FLOOR);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_finds_the_bottom_of_a_bowl_and_decays_what_has_no_slope() {
        let mut numbers = vec![3.0, -2.0, 1.0];
        let mut memory = Memory::new(3);
        for done in 0..2000 {
            // A bowl ten thousand times steeper one way than the other.
            let mut slopes = vec![100.0 * (numbers[0] - 1.0), 0.01 * (numbers[1] - 1.0), 0.0];
            let rate = 0.05 * (1.0 - done as f64 / 2000.0);
            memory.step(&mut numbers, &mut slopes, &[false, false, true], (rate, 0.02), done);
        }
        assert!((numbers[0] - 1.0).abs() < 1e-2 && (numbers[1] - 1.0).abs() < 1e-2, "{numbers:?}");
        // exp(−Σ rate · decay), the rates summing to 50.
        assert!((numbers[2] - (-1.0f32).exp()).abs() < 2e-3, "{numbers:?}");
    }
}
