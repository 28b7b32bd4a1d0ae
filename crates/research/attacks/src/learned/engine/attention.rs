//! Multi-head self-attention: every keypoint looks at all others of its image.

use super::Matrix;
use super::exponential::softmax;

/// Keypoints whose attention is computed together: of a whole image the table of all pairs would fill memory.
const COLUMNS: usize = 512;

/// What the way back needs: who looked at whom.
#[derive(Debug)]
pub(crate) struct Looked {
    /// By head, then by block of keypoints: `[N, block]`, columns that sum to one.
    shares: Vec<Vec<Matrix>>,
}

/// `[3 width, N]`, queries, keys and values of all heads one after another → `[width, N]`.
///
/// With `keep` also what the way back needs.
pub(crate) fn attend(parts: &Matrix, heads: usize, keep: bool) -> (Matrix, Looked) {
    let (width, n) = (parts.nrows() / 3, parts.ncols());
    let each = width / heads;
    let scale = 1.0 / (each as f32).sqrt();
    let mut seen = Matrix::zeros(width, n);
    let mut shares = Vec::new();
    for head in 0..heads {
        let queries = parts.rows(head * each, each) * scale;
        let keys = parts.rows(width + head * each, each).transpose();
        let values: Matrix = parts.rows(2 * width + head * each, each).into_owned();
        let mut blocks = Vec::new();
        for start in (0..n).step_by(COLUMNS) {
            let some = COLUMNS.min(n - start);
            let mut share = &keys * queries.columns(start, some);
            share.as_mut_slice().chunks_exact_mut(n).for_each(|column| {
                softmax(column);
            });
            seen.view_mut((head * each, start), (each, some)).copy_from(&(&values * &share));
            if keep {
                blocks.push(share);
            }
        }
        shares.push(blocks);
    }
    (seen, Looked { shares })
}

/// From the derivatives of what was seen, `[width, N]`, to those of queries, keys and values, `[3 width, N]`.
pub(crate) fn attend_back(parts: &Matrix, looked: &Looked, dseen: &Matrix) -> Matrix {
    let (width, n) = (parts.nrows() / 3, parts.ncols());
    let heads = looked.shares.len();
    let each = width / heads;
    let scale = 1.0 / (each as f32).sqrt();
    let mut slopes = Matrix::zeros(3 * width, n);
    for (head, blocks) in looked.shares.iter().enumerate() {
        let queries: Matrix = parts.rows(head * each, each) * scale;
        let keys: Matrix = parts.rows(width + head * each, each).into_owned();
        let values = parts.rows(2 * width + head * each, each).transpose();
        // Transposed: [N, each].
        let mut dkeys = Matrix::zeros(n, each);
        let mut dvalues = Matrix::zeros(n, each);
        for (block, share) in blocks.iter().enumerate() {
            let (start, some) = (block * COLUMNS, share.ncols());
            let out: Matrix = dseen.view((head * each, start), (each, some)).into_owned();
            dvalues.gemm(1.0, share, &out.transpose(), 1.0);
            let mut slope = &values * &out;
            let columns = slope.as_mut_slice().chunks_exact_mut(n).zip(share.as_slice().chunks_exact(n));
            for (d, p) in columns {
                let along = dot(d, p);
                d.iter_mut().zip(p).for_each(|(d, p)| *d = p * (*d - along));
            }
            dkeys.gemm(1.0, &slope, &queries.columns(start, some).transpose(), 1.0);
            let dqueries = &keys * &slope * scale;
            slopes.view_mut((head * each, start), (each, some)).copy_from(&dqueries);
        }
        slopes.rows_mut(width + head * each, each).copy_from(&dkeys.transpose());
        slopes.rows_mut(2 * width + head * each, each).copy_from(&dvalues.transpose());
    }
    slopes
}

/// Eight sums side by side: fast, and the same on every machine.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0f32; 8];
    for (a, b) in a.chunks(8).zip(b.chunks(8)) {
        for (s, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *s += a * b;
        }
    }
    sums.iter().sum()
}
