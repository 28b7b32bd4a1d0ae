//! What training makes small: neighbours that are not taken for such.

use crate::learned::engine::Matrix;
use crate::learned::engine::exponential::softmax;

/// What the loss says, with its derivatives.
pub(super) struct Judged {
    pub(super) loss: f64,
    /// By what came in, `[width, N]`.
    pub(super) slopes: Matrix,
    /// By the logarithm of the scale.
    pub(super) scale: f32,
}

/// Unit columns, and what each was divided by.
pub(super) fn unit(embedded: &Matrix) -> (Matrix, Vec<f32>) {
    let mut units = embedded.clone();
    let lengths = units
        .column_iter_mut()
        .map(|mut column| {
            let length = (column.norm_squared() + 1e-12).sqrt();
            column /= length;
            length
        })
        .collect();
    (units, lengths)
}

/// Mean over keypoints of the cross entropy between the targets and the softmax of their logits.
///
/// The logit of a pair is the cosine of its columns of `embedded`, `[width, N]`, times `e^log_scale`; that of a keypoint
/// with itself does not count. `targets` are `[N, N]`: a column holds the share of each neighbour and sums to one, or it
/// is all zero, and then the keypoint does not count (InfoNCE with several positives). `rows` columns count, at least 1.
pub(super) fn loss(embedded: &Matrix, log_scale: f32, targets: &Matrix, rows: usize) -> Judged {
    let n = embedded.ncols();
    let (units, lengths) = unit(embedded);
    let scale = log_scale.exp();
    let mut logits = units.transpose() * &units * scale;
    let share = 1.0 / rows.max(1) as f32;
    let (mut loss, mut of_scale) = (0.0, 0.0f64);
    let columns = logits.as_mut_slice().chunks_exact_mut(n).zip(targets.as_slice().chunks_exact(n));
    for (i, (column, target)) in columns.enumerate() {
        let whole: f32 = target.iter().sum();
        if whole == 0.0 {
            column.fill(0.0);
            continue;
        }
        column[i] = f32::NEG_INFINITY;
        let mut shares = column.to_vec();
        let sum = softmax(&mut shares);
        for (j, (logit, target)) in column.iter_mut().zip(target).enumerate() {
            let value = *logit;
            *logit = 0.0;
            if j == i {
                continue;
            }
            if *target > 0.0 {
                loss += f64::from(target * (sum - value));
            }
            *logit = share * (whole * shares[j] - target);
            of_scale += f64::from(*logit * value);
        }
    }
    let slopes = &units * (&logits + logits.transpose()) * scale;
    let slopes = Matrix::from_columns(
        &slopes
            .column_iter()
            .zip(units.column_iter())
            .zip(&lengths)
            .map(|((d, u), length)| (d - u * u.dot(&d)) / *length)
            .collect::<Vec<_>>(),
    );
    Judged { loss: loss * f64::from(share), slopes, scale: of_scale as f32 }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn it_is_the_entropy_of_a_lot_and_nothing_where_all_is_known() {
        let half = Matrix::from_fn(3, 3, |i, j| if i == j { 0.0 } else { 0.5 });
        let alike = Matrix::from_element(2, 3, 1.0);
        assert!((loss(&alike, 2.0, &half, 3).loss - 2f64.ln()).abs() < 1e-6);
        // Two alike and one the other way: each of the two has the other for its neighbour, and the third has none.
        let pair = Matrix::from_row_slice(3, 3, &[0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let apart = Matrix::from_row_slice(1, 3, &[1.0, 2.0, -1.0]);
        assert!(loss(&apart, 3.0, &pair, 2).loss < 1e-6, "the third does not count");
        let wrong = Matrix::from_row_slice(1, 3, &[1.0, -2.0, 1.0]);
        let first = 2.0 * 3f64.exp() + 1e-9;
        let told = loss(&wrong, 3.0, &pair, 2).loss;
        let both = f64::midpoint((first.exp() + 1.0).ln(), 2f64.ln());
        assert!((told - both).abs() < 0.1 * both, "{told} {both}");
    }

    #[test]
    fn derivatives_are_those_of_the_loss() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (n, width) = (9, 4);
        let embedded = Matrix::from_fn(width, n, |_, _| rng.random_range(-1.0..1.0));
        let mut targets = Matrix::zeros(n, n);
        for i in 0..n - 1 {
            targets[((i + 1) % n, i)] = 0.5;
            targets[((i + 3) % n, i)] = 0.5;
        }
        let told = loss(&embedded, 1.3, &targets, n - 1);
        let along = Matrix::from_fn(width, n, |_, _| rng.random_range(-1.0..1.0));
        let h = 1e-2;
        let at = |t: f32| loss(&(&embedded + &along * t), 1.3, &targets, n - 1).loss;
        let slope = f64::from(told.slopes.dot(&along));
        assert!(((at(h) - at(-h)) / f64::from(2.0 * h) - slope).abs() < 1e-3, "{slope}");
        let scaled = |t: f32| loss(&embedded, 1.3 + t, &targets, n - 1).loss;
        let slope = f64::from(told.scale);
        assert!(((scaled(h) - scaled(-h)) / f64::from(2.0 * h) - slope).abs() < 1e-3, "{slope}");
    }
}
