//! Cores by recursive bisection of the images.

use veiloc_geometry::nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::border::{Border, HalfSizes};
use super::covisibility::Covisibility;

/// Bisects images.
pub(super) struct Bisection<'a> {
    pub(super) shared: &'a Covisibility,
    /// `[I]`, camera centres in the world, map units.
    pub(super) centres: &'a [[f64; 3]],
    /// Maximum number of images per core.
    pub(super) core: usize,
}

impl Bisection<'_> {
    /// Cores of all images, as few as possible, each in ascending order.
    pub(super) fn cores(&self) -> Vec<Vec<u32>> {
        let all: Vec<u32> = (0..self.centres.len() as u32).collect();
        let mut cores = Vec::new();
        // An explicit stack that processes the left half first, so that neighbouring cores are neighbours in the
        // list.
        let count = all.len().div_ceil(self.core);
        let mut open = vec![(all, count)];
        while let Some((images, count)) = open.pop() {
            if count == 1 {
                cores.push(images);
                continue;
            }
            let left_count = count / 2;
            let sizes = HalfSizes::new(images.len(), left_count, count - left_count, self.core);
            let (left, right) = self.halves(&images, &sizes);
            open.push((right, count - left_count));
            open.push((left, left_count));
        }
        cores
    }

    /// The bisection that separates the fewest shared points: one start per principal axis of the camera centres,
    /// each refined; ties go to the first.
    fn halves(&self, images: &[u32], sizes: &HalfSizes) -> (Vec<u32>, Vec<u32>) {
        let begun = |axis: &Vector3<f64>| {
            let mut along: Vec<(f64, u32)> =
                images.iter().map(|image| (self.at(*image).dot(axis), *image)).collect();
            along.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let left: Vec<u32> = along[..sizes.target].iter().map(|(_, image)| *image).collect();
            Border::new(self.shared, images, &left).refined(sizes)
        };
        let best = self.axes(images).iter().map(begun).min_by_key(|border| border.cost());
        best.expect("three axes").halves()
    }

    /// The principal axes of the camera centres, longest first; the axes of the map if the centres are degenerate.
    fn axes(&self, images: &[u32]) -> [Vector3<f64>; 3] {
        let count = images.len() as f64;
        let mean = images.iter().fold(Vector3::zeros(), |sum, image| sum + self.at(*image) / count);
        let spread = images.iter().fold(Matrix3::zeros(), |sum, image| {
            let off = self.at(*image) - mean;
            sum + off * off.transpose() / count
        });
        let scale = spread.diagonal().max();
        if !(scale > 0.0 && spread.iter().all(|s| s.is_finite())) {
            return [Vector3::x(), Vector3::y(), Vector3::z()];
        }
        let eigen = SymmetricEigen::new(spread / scale);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]).then(a.cmp(b)));
        order.map(|axis| eigen.eigenvectors.column(axis).into_owned())
    }

    fn at(&self, image: u32) -> Vector3<f64> {
        Vector3::from(self.centres[image as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Images in a row, each sharing points with its two nearest neighbours on both sides.
    fn row(count: u32) -> (Covisibility, Vec<[f64; 3]>) {
        let near = |image: u32| {
            let others =
                (1..=2).flat_map(move |d| [image.checked_sub(d), Some(image + d).filter(|i| *i < count)]);
            others.flatten().map(|other| (other, 10)).collect()
        };
        let centres = (0..count).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        (Covisibility::of_lists((0..count).map(near).collect()), centres)
    }

    fn cores(shared: &Covisibility, centres: &[[f64; 3]], core: usize) -> Vec<Vec<u32>> {
        let cores = Bisection { shared, centres, core }.cores();
        let mut all = cores.concat();
        all.sort_unstable();
        assert_eq!(all, (0..centres.len() as u32).collect::<Vec<_>>(), "each image in one core");
        assert!(cores.iter().all(|c| c.len() <= core && !c.is_empty() && c.is_sorted()));
        assert_eq!(cores.len(), centres.len().div_ceil(core));
        cores
    }

    #[test]
    fn row_is_cut_into_contiguous_cores() {
        let (shared, centres) = row(100);
        for core in [1, 7, 20, 33, 99] {
            for core in cores(&shared, &centres, core) {
                assert_eq!((core[core.len() - 1] - core[0]) as usize, core.len() - 1, "{core:?}");
            }
        }
    }

    /// Two rooms separated by a wall along the row of cameras: the centres alone would suggest a cut across both.
    #[test]
    fn cut_follows_covisibility_rather_than_centres() {
        let room = |image: u32| image % 2;
        let near = |image: u32| {
            let others = (0..40).filter(|other| *other != image && room(*other) == room(image));
            others.map(|other| (other, 5)).collect()
        };
        let shared = Covisibility::of_lists((0..40).map(near).collect());
        let centres: Vec<[f64; 3]> =
            (0..40).map(|i| [f64::from(i / 2), 0.1 * f64::from(room(i)), 0.0]).collect();
        for core in cores(&shared, &centres, 20) {
            assert!(core.iter().all(|image| room(*image) == room(core[0])), "{core:?}");
        }
    }

    #[test]
    fn images_without_shared_points_are_cut() {
        let shared = Covisibility::of_lists(vec![Vec::new(); 30]);
        assert_eq!(cores(&shared, &[[1.0, 2.0, 3.0]; 30], 7).len(), 5);
        let far: Vec<[f64; 3]> = (0..30).map(|i| [1e200 * f64::from(i), 0.0, 1e-200]).collect();
        cores(&shared, &far, 7);
    }
}
