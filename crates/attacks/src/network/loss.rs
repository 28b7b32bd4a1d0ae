//! What training makes small: neighbours that are not taken for such.

use burn::tensor::activation::log_softmax;
use burn::tensor::backend::Backend;
use burn::tensor::{Tensor, TensorData};

/// Taken off the logit of a keypoint with itself, so that it never counts.
const FAR: f32 = 1e9;

/// Mean over keypoints of the cross entropy between the targets and the softmax of their logits, `[1]`.
///
/// `logits` and `targets` are `[N, N]`; a row of targets is the share of each neighbour and sums to one, or it is all
/// zero, and then the keypoint does not count (InfoNCE with several positives). With `rows` rows that count, at least 1.
pub(super) fn loss<B: Backend>(logits: Tensor<B, 2>, targets: Tensor<B, 2>, rows: usize) -> Tensor<B, 1> {
    let n = logits.dims()[0];
    let mut own = vec![0.0f32; n * n];
    own.iter_mut().step_by(n + 1).for_each(|x| *x = FAR);
    let own = Tensor::from_data(TensorData::new(own, [n, n]), &logits.device());
    let said = log_softmax(logits - own, 1);
    // The diagonal holds −FAR, and no target.
    said.mul(targets).sum().mul_scalar(-1.0 / rows.max(1) as f32)
}

#[cfg(test)]
mod tests {
    use burn::backend::ndarray::NdArrayDevice;

    use super::super::Cpu;
    use super::*;

    fn of(logits: [[f32; 3]; 3], targets: [[f32; 3]; 3], rows: usize) -> f32 {
        let tensor =
            |x: [[f32; 3]; 3]| Tensor::<Cpu, 2>::from_data(TensorData::from(x), &NdArrayDevice::default());
        loss(tensor(logits), tensor(targets), rows).into_scalar()
    }

    #[test]
    fn it_is_the_entropy_of_a_lot_and_nothing_where_all_is_known() {
        let half = [[0.0, 0.5, 0.5], [0.5, 0.0, 0.5], [0.5, 0.5, 0.0]];
        assert!((of([[0.0; 3]; 3], half, 3) - 2f32.ln()).abs() < 1e-6);
        let sure = [[9.0, 40.0, 0.0], [40.0, 9.0, 0.0], [7.0, 7.0, 7.0]];
        let pair = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0; 3]];
        assert!(
            of(sure, pair, 2).abs() < 1e-6,
            "the third has no neighbour and its own logit does not count"
        );
        let wrong = [[9.0, 0.0, 3.0], [40.0, 9.0, 0.0], [7.0, 7.0, 7.0]];
        let first = (1.0 + 3f32.exp()).ln();
        assert!((of(wrong, pair, 2) - first / 2.0).abs() < 1e-5);
    }
}
