//! Functions over the image in which lines are told and answers are given: products of cosines.
//!
//! A **line** is told by what each function is worth on it, on average over where the keypoint may be. An **answer** is
//! a sum of the same functions: the logarithm of how likely the keypoint is here or there in the image, up to a
//! constant. So lines of any scheme, and rows of one query, are told alike; what several lines have in common is a
//! product of such numbers; and an answer is held against the own line by asking it at places along that line.

use veiloc_geometry::Pixel;

/// Half waves across the longer side of the image at most, all directions alike.
pub(super) const MOST_WAVES: usize = 11;

/// `cos(π m x) cos(π n y)` for all `m² + n²` up to the square of [`MOST_WAVES`], but for the constant.
///
/// `x` and `y` run along the sides of the image in shares of the longer side, its middle at ½.
#[derive(Debug, Clone)]
pub(super) struct Waves {
    list: Vec<(usize, usize)>,
}

impl Waves {
    pub(super) fn new() -> Self {
        let all = (0..=MOST_WAVES).flat_map(|m| (0..=MOST_WAVES).map(move |n| (m, n)));
        let list = all.filter(|(m, n)| (1..=MOST_WAVES * MOST_WAVES).contains(&(m * m + n * n))).collect();
        Self { list }
    }

    /// How many functions there are.
    pub(super) fn len(&self) -> usize {
        self.list.len()
    }

    /// The value of each at a place in an image of this size.
    pub(super) fn at(&self, place: Pixel, [width, height]: [u32; 2], values: &mut [f32]) {
        let longer = f64::from(width.max(height).max(1));
        let share = |x: f64, side: u32| ((x - 0.5 * f64::from(side)) / longer + 0.5) as f32;
        let across = cosines(share(place.u, width));
        let down = cosines(share(place.v, height));
        for (value, (m, n)) in values.iter_mut().zip(&self.list) {
            *value = across[*m] * down[*n];
        }
    }
}

/// `cos(π m x)` for `m` from 0.
fn cosines(x: f32) -> [f32; MOST_WAVES + 1] {
    let first = (std::f32::consts::PI * x).cos();
    let mut all = [1.0; MOST_WAVES + 1];
    all[1] = first;
    for m in 2..=MOST_WAVES {
        all[m] = 2.0 * first * all[m - 1] - all[m - 2];
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn they_are_cosines_and_mirror_with_the_image() {
        let waves = Waves::new();
        let value = |u: f64, v: f64| {
            let mut values = vec![0.0; waves.len()];
            waves.at(Pixel::new(u, v), [640, 480], &mut values);
            values
        };
        let (here, mirrored) = (value(150.0, 333.0), value(640.0 - 150.0, 333.0));
        let (x, y) = (150.0 / 640.0, (333.0 - 240.0) / 640.0 + 0.5);
        for (i, &(m, n)) in waves.list.iter().enumerate() {
            let known = (PI * m as f64 * x).cos() * (PI * n as f64 * y).cos();
            assert!((f64::from(here[i]) - known).abs() < 2e-5, "{m} {n}");
            let sign = if m % 2 == 0 { 1.0 } else { -1.0 };
            assert!((here[i] - sign * mirrored[i]).abs() < 2e-5, "{m} {n}");
        }
        assert!(!waves.list.contains(&(0, 0)) && waves.len() > 90, "{}", waves.len());
    }
}
