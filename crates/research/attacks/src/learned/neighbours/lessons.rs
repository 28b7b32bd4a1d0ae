//! What the network learns from: random subsets of the keypoints of an image, and who is near whom among them.

use crate::{Descriptors, KnownImage, NeighbourLists};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use crate::learned::engine::Matrix;

/// An image made ready for training.
pub(super) struct Lesson {
    /// `[dimension, N]`
    input: Matrix,
    near: NeighbourLists,
}

/// Some keypoints of one image.
pub(super) struct Batch {
    /// `[dimension, n]`
    pub(super) input: Matrix,
    /// `[n, n]`: shares of the neighbours, each column summing to one, or to zero where none was drawn.
    pub(super) targets: Matrix,
    /// Columns of targets that are not all zero.
    pub(super) rows: usize,
}

/// `[dimension, N]`: descriptors as the network sees them, the image's mean taken off, entries near one.
pub(crate) fn input(descriptors: &Descriptors) -> Matrix {
    let columns = descriptors.centered();
    let scale = (columns.nrows() as f32).sqrt();
    columns * scale
}

impl Lesson {
    /// The `k` nearest keypoints of each are its neighbours; `None` when no keypoint has any.
    pub(super) fn new(image: &KnownImage, k: usize) -> Option<Self> {
        let near = NeighbourLists::nearest(image.keypoints(), k);
        let any = (0..near.len()).any(|i| !near.of(i).is_empty());
        any.then(|| Self { input: input(image.descriptors()), near })
    }

    /// At most `most` keypoints, drawn without repetition.
    pub(super) fn draw(&self, most: usize, rng: &mut ChaCha8Rng) -> Batch {
        let all = self.near.len();
        let n = most.min(all);
        let mut order: Vec<usize> = (0..all).collect();
        for i in 0..n {
            order.swap(i, rng.random_range(i..all));
        }
        order.truncate(n);
        let mut place = vec![usize::MAX; all];
        order.iter().enumerate().for_each(|(at, i)| place[*i] = at);

        let input = self.input.select_columns(&order);
        let mut batch = Batch { input, targets: Matrix::zeros(n, n), rows: 0 };
        for (row, &i) in batch.targets.as_mut_slice().chunks_exact_mut(n).zip(&order) {
            let drawn: Vec<usize> =
                self.near.of(i).iter().map(|j| place[*j as usize]).filter(|at| *at != usize::MAX).collect();
            for at in &drawn {
                row[*at] = 1.0 / drawn.len() as f32;
            }
            batch.rows += usize::from(!drawn.is_empty());
        }
        batch
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use veiloc_geometry::Pixel;

    use super::*;

    #[test]
    fn targets_are_the_neighbours_that_were_drawn() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let keypoints: Vec<Pixel> =
            (0..50).map(|_| Pixel::new(rng.random_range(0.0..90.0), rng.random_range(0.0..90.0))).collect();
        // The descriptor says which keypoint it is.
        let bytes: Vec<u8> = (0..50).flat_map(|i| (0..50).map(move |j| u8::from(i == j))).collect();
        let descriptors = Descriptors::new(&bytes, 50).expect("whole");
        let near = NeighbourLists::nearest(&keypoints, 6);
        let image = KnownImage::new(keypoints, descriptors, 90, 90).expect("one each");
        let lesson = Lesson::new(&image, 6).expect("neighbours");
        let batch = lesson.draw(20, &mut rng);
        assert_eq!((batch.input.shape(), batch.targets.shape()), ((50, 20), (20, 20)));
        let drawn: Vec<usize> = batch.input.column_iter().map(|column| column.imax()).collect();
        let mut counted = 0;
        for (row, &i) in batch.targets.as_slice().chunks(20).zip(&drawn) {
            let sum: f32 = row.iter().sum();
            counted += usize::from(sum > 0.0);
            assert!(sum == 0.0 || (sum - 1.0).abs() < 1e-6, "{sum}");
            for (share, &j) in row.iter().zip(&drawn) {
                assert_eq!(*share > 0.0, near.of(i).contains(&(j as u32)), "{i} {j}");
            }
        }
        assert_eq!(counted, batch.rows);
        assert_eq!(lesson.draw(80, &mut rng).input.ncols(), 50, "no more than there are");
    }
}
