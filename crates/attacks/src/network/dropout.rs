//! Dropout whose draws come from a generator of ours: burn's own draw from one that all threads share.

use burn::tensor::backend::Backend;
use burn::tensor::{Tensor, TensorData};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Sets entries to zero at random while a network learns, so that it leans on none of them.
pub(super) struct Dropout<'a> {
    drawing: Option<(f64, &'a mut ChaCha8Rng)>,
}

impl<'a> Dropout<'a> {
    /// Nothing is dropped.
    pub(super) const fn none() -> Self {
        Self { drawing: None }
    }

    /// This share is dropped, and the rest made larger so that sums stay.
    pub(super) fn new(share: f64, rng: &'a mut ChaCha8Rng) -> Self {
        Self { drawing: (share > 0.0).then_some((share, rng)) }
    }

    pub(super) fn apply<B: Backend>(&mut self, x: Tensor<B, 2>) -> Tensor<B, 2> {
        let Some((share, rng)) = &mut self.drawing else { return x };
        let [rows, columns] = x.dims();
        let kept = (1.0 / (1.0 - *share)) as f32;
        let mask: Vec<f32> =
            (0..rows * columns).map(|_| if rng.random::<f64>() < *share { 0.0 } else { kept }).collect();
        let mask = Tensor::from_data(TensorData::new(mask, [rows, columns]), &x.device());
        x.mul(mask)
    }
}
