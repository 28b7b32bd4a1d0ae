//! What an image's descriptors would be if the image were mirrored.
//!
//! A SIFT descriptor is `[4 rows, 4 columns, 8 directions]` along the keypoint's own axes, the first of which is its
//! orientation. In the mirrored image the orientation is mirrored with everything else, so along it nothing changes;
//! across it, rows come in the opposite order, and a direction is turned the other way.

use crate::learned::engine::Matrix;

/// Length of a descriptor for which this holds.
pub(super) const DIMENSION: usize = ROWS * COLUMNS * DIRECTIONS;
const ROWS: usize = 4;
const COLUMNS: usize = 4;
const DIRECTIONS: usize = 8;

/// `[DIMENSION, N]` → the same of the mirrored image.
pub(super) fn mirrored(descriptors: &Matrix) -> Matrix {
    Matrix::from_fn(descriptors.nrows(), descriptors.ncols(), |entry, column| {
        let (row, rest) = (entry / (COLUMNS * DIRECTIONS), entry % (COLUMNS * DIRECTIONS));
        let (along, direction) = (rest / DIRECTIONS, rest % DIRECTIONS);
        let source = (ROWS - 1 - row) * COLUMNS * DIRECTIONS
            + along * DIRECTIONS
            + (DIRECTIONS - direction) % DIRECTIONS;
        descriptors[(source, column)]
    })
}

#[cfg(test)]
mod tests {
    use crate::Descriptors;
    use image::{Rgb, RgbImage};
    use veiloc_features::{Limits, Sift, extract_image};

    use super::*;
    use crate::learned::neighbours::input;

    /// An image with corners and blobs of many directions, and its mirror image.
    #[test]
    fn descriptors_of_the_mirrored_image_are_the_mirrored_descriptors() {
        let wave = |x: f64, y: f64| {
            let a = (0.11 * x + 0.07 * y).sin() * (0.05 * x - 0.13 * y).cos();
            let b = (0.31 * x - 0.02 * y).sin() * (0.19 * y).sin();
            let c = ((x - 130.0).hypot(y - 90.0) * 0.23).sin();
            (127.0 + 45.0 * a + 40.0 * b + 40.0 * c) as u8
        };
        let folder = std::env::temp_dir().join(format!("veiloc-mirror-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let extracted = |flip: bool| {
            let image = RgbImage::from_fn(320, 240, |x, y| {
                let x = if flip { 319 - x } else { x };
                Rgb([wave(f64::from(x), f64::from(y)); 3])
            });
            let path = folder.join(format!("{flip}.png"));
            image.save(&path).expect("written");
            let limits = Limits { max_keypoints: 2048, max_side: 640 };
            extract_image(&path, None, &Sift::default(), limits).expect("an image").features
        };
        let (here, there) = (extracted(false), extracted(true));
        std::fs::remove_dir_all(&folder).expect("ours");
        let columns = |f: &veiloc_features::Features| input(&Descriptors::of(f.descriptors.view()));
        let (own, other) = (mirrored(&columns(&here)), columns(&there));
        let plain = columns(&here);
        let (mut close, mut far, mut pairs) = (0, 0, 0);
        for (i, a) in here.keypoints.iter().enumerate() {
            // The same place in the mirrored image, and of several orientations there the likest descriptor.
            let at = 320.0 - a.pixel.u;
            let same: Vec<usize> = (0..there.keypoints.len())
                .filter(|j| {
                    let b = &there.keypoints[*j];
                    (b.pixel.u - at).abs() < 0.2 && (b.pixel.v - a.pixel.v).abs() < 0.2
                })
                .collect();
            let least = |all: &Matrix| {
                let distance = |j: &usize| (all.column(i) - other.column(*j)).norm();
                same.iter().map(distance).fold(f32::MAX, f32::min)
            };
            if !same.is_empty() {
                pairs += 1;
                close += usize::from(least(&own) < 2.0);
                far += usize::from(least(&plain) > 4.0);
            }
        }
        // Columns are some eleven long.
        assert!(pairs > 60, "{pairs} pairs");
        assert!(close * 10 > pairs * 9, "{close} of {pairs} are close");
        assert!(far * 2 > pairs, "without mirroring {far} of {pairs} are far");
    }
}
