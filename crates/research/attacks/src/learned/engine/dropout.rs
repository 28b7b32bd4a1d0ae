//! Dropout: entries set to zero at random while a network learns, so that it leans on none of them.

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::Matrix;

/// Drops entries, or none.
pub(crate) struct Dropout<'a> {
    drawing: Option<(f64, &'a mut ChaCha8Rng)>,
}

impl<'a> Dropout<'a> {
    /// Nothing is dropped.
    pub(crate) const fn none() -> Self {
        Self { drawing: None }
    }

    /// This share is dropped, and the rest made larger so that sums stay.
    pub(crate) fn new(share: f64, rng: &'a mut ChaCha8Rng) -> Self {
        Self { drawing: (share > 0.0).then_some((share, rng)) }
    }

    /// Drops entries, and returns the factor of each for the way back; `None` where nothing is dropped.
    pub(crate) fn apply(&mut self, x: &mut Matrix) -> Option<Matrix> {
        let (share, rng) = self.drawing.as_mut()?;
        let kept = (1.0 / (1.0 - *share)) as f32;
        let limit = (*share * f64::from(u32::MAX)) as u32;
        let factors =
            Matrix::from_fn(
                x.nrows(),
                x.ncols(),
                |_, _| {
                    if rng.random::<u32>() < limit { 0.0 } else { kept }
                },
            );
        x.component_mul_assign(&factors);
        Some(factors)
    }
}
