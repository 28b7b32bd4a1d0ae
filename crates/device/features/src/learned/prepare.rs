//! The input of a network: the image at the network's size, continued by its mirror image, and normalized.

use crate::GrayImage;

use crate::learned::Tensor;
use crate::learned::description::{Input, Normalize};

/// Position of the image in the network's input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Placement {
    /// Scale from the image to the network's input, across and down.
    scale: [f64; 2],
    /// First column and row of the image in the network's input.
    offset: [usize; 2],
    /// Columns and rows of the image in the network's input.
    size: [usize; 2],
}

impl Placement {
    /// Transforms a position of the network's input (integers are pixel centres) to the image, whose corner is at 0, 0.
    pub(crate) fn to_image(self, [x, y]: [f64; 2]) -> [f64; 2] {
        let back = |at: f64, axis: usize| (at + 0.5 - self.offset[axis] as f64) / self.scale[axis];
        [back(x, 0), back(y, 1)]
    }

    /// Pixels of the image per pixel of the network's input.
    pub(crate) fn pixel(self) -> f64 {
        1.0 / (self.scale[0] * self.scale[1]).sqrt()
    }

    /// Whether a pixel of the network's input belongs to the image, at this distance from its border.
    pub(crate) fn inside(self, [x, y]: [usize; 2], border: usize) -> bool {
        let within = |at: usize, axis: usize| {
            let (first, end) =
                (self.offset[axis] + border, (self.offset[axis] + self.size[axis]).saturating_sub(border));
            (first..end).contains(&at)
        };
        within(x, 0) && within(y, 1)
    }
}

/// `[1, C, H, W]`, and the position of the image in it. `fixed`: width and height when the network has a fixed size.
///
/// The mirror image hides the image's own border: convolutions pad with zeros, and their effect would distinguish
/// descriptors near the border from others (rule L11 of docs/reference/privacy-rules.md).
pub(crate) fn prepare(image: &GrayImage, input: &Input, fixed: Option<[usize; 2]>) -> (Tensor, Placement) {
    let own = [image.width() as usize, image.height() as usize];
    let margin = input.margin;
    let (size, whole) = if let Some(whole) = fixed {
        let available = whole.map(|side| side.saturating_sub(2 * margin).max(1));
        let scale = (available[0] as f64 / own[0] as f64).min(available[1] as f64 / own[1] as f64);
        let fitted = |axis: usize| ((own[axis] as f64 * scale).round() as usize).clamp(1, available[axis]);
        ([fitted(0), fitted(1)], whole)
    } else {
        let longest = input.longest_side.map_or(usize::MAX, |side| side as usize);
        let scale = (longest as f64 / own[0].max(own[1]) as f64).min(1.0);
        let size = own.map(|side| ((side as f64 * scale).round() as usize).max(1));
        (size, size.map(|side| (side + 2 * margin).next_multiple_of(input.multiple)))
    };
    let offset = [0, 1].map(|axis| (whole[axis] - size[axis]) / 2);
    let mut samples = resized(image, size);
    normalize_image(&mut samples, input);
    let [width, height] = whole;
    let across: Vec<usize> = (0..width).map(|x| mirrored(x, offset[0], size[0])).collect();
    let mut plane = Vec::with_capacity(width * height);
    for y in 0..height {
        let row = &samples[mirrored(y, offset[1], size[1]) * size[0]..][..size[0]];
        plane.extend(across.iter().map(|x| row[*x]));
    }
    let mut data = Vec::with_capacity(input.channels * plane.len());
    for channel in 0..input.channels {
        match &input.normalize {
            Normalize::By { mean, deviation } => {
                data.extend(plane.iter().map(|sample| (sample - mean[channel]) / deviation[channel]));
            }
            Normalize::None | Normalize::Image => data.extend_from_slice(&plane),
        }
    }
    let scale = [0, 1].map(|axis| size[axis] as f64 / own[axis] as f64);
    (Tensor { shape: vec![1, input.channels, height, width], data }, Placement { scale, offset, size })
}

/// The index of the sample at `at`, when the first sample is at `offset` and the rest is mirror image.
fn mirrored(at: usize, offset: usize, size: usize) -> usize {
    let period = 2 * size as isize;
    let folded = (at as isize - offset as isize).rem_euclid(period);
    folded.min(period - 1 - folded) as usize
}

/// The samples at another size, row by row: area means for scaling down, linear interpolation for enlarging.
pub(crate) fn resized(image: &GrayImage, [width, height]: [usize; 2]) -> Vec<f32> {
    let own = [image.width() as usize, image.height() as usize];
    if own == [width, height] {
        return image.data().to_vec();
    }
    if width <= own[0] && height <= own[1] {
        return image.resized(width as u32, height as u32).data().to_vec();
    }
    let (columns, rows) = (axis(own[0], width), axis(own[1], height));
    let mut samples = Vec::with_capacity(width * height);
    for (upper, lower, down) in rows {
        let (upper, lower) = (image.row(upper as u32), image.row(lower as u32));
        samples.extend(columns.iter().map(|(left, right, across)| {
            let mix = |row: &[f32]| row[*left] + (row[*right] - row[*left]) * across;
            mix(upper) + (mix(lower) - mix(upper)) * down
        }));
    }
    samples
}

/// For each new sample the two old ones around it, and the weight of the second.
fn axis(old: usize, new: usize) -> Vec<(usize, usize, f32)> {
    let step = old as f64 / new as f64;
    (0..new)
        .map(|i| {
            let at = ((i as f64 + 0.5) * step - 0.5).clamp(0.0, old as f64 - 1.0);
            let first = at as usize;
            (first, (first + 1).min(old - 1), (at - first as f64) as f32)
        })
        .collect()
}

/// Mean 0 and variance 1, as in PyTorch's `InstanceNorm2d`, over the image without its mirror image.
fn normalize_image(samples: &mut [f32], input: &Input) {
    if input.normalize != Normalize::Image {
        return;
    }
    let count = samples.len() as f64;
    let mean = samples.iter().map(|s| f64::from(*s)).sum::<f64>() / count;
    let variance = samples.iter().map(|s| (f64::from(*s) - mean).powi(2)).sum::<f64>() / count;
    let factor = 1.0 / (variance + 1e-5).sqrt();
    for sample in samples {
        *sample = ((f64::from(*sample) - mean) * factor) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: u32, height: u32) -> GrayImage {
        let samples = (0..width * height).map(|i| (i % width) as f32 / 100.0 + (i / width) as f32 / 1000.0);
        GrayImage::new(width, height, samples.collect()).expect("whole rows")
    }

    fn input(margin: usize, multiple: usize, longest: Option<u32>) -> Input {
        Input { channels: 3, normalize: Normalize::None, multiple, longest_side: longest, margin }
    }

    #[test]
    fn margin_is_the_mirror_image() {
        let (tensor, placement) = prepare(&ramp(20, 10), &input(4, 8, None), None);
        // 28 and 18 are not multiples of 8.
        assert_eq!(tensor.shape, [1, 3, 24, 32]);
        assert_eq!((placement.offset, placement.size), ([6, 7], [20, 10]));
        let at = |x: usize, y: usize| tensor.data[(24 + y) * 32 + x];
        let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-6, "{a} {b}");
        near(at(6, 7), 0.0);
        near(at(5, 7), 0.0);
        near(at(4, 6), 0.01);
        near(at(26, 7), 0.19);
        near(at(27, 17), 0.189);
        assert_eq!(placement.to_image([6.0, 7.0]), [0.5, 0.5]);
        assert!(
            placement.inside([6, 7], 0) && !placement.inside([6, 7], 1) && !placement.inside([26, 10], 0)
        );
        assert_eq!(mirrored(0, 7, 3), 0, "a mirror image of the mirror image");
    }

    #[test]
    fn positions_are_invertible_for_any_size() {
        for (fixed, longest) in [(None, Some(64)), (Some([96, 96]), None), (Some([300, 200]), None)] {
            let image = ramp(128, 80);
            let (tensor, placement) = prepare(&image, &input(8, 8, longest), fixed);
            let [_, _, height, width] = tensor.shape[..] else { panic!("four sides") };
            for [x, y] in [[20, 24], [40, 40]] {
                let [u, v] = placement.to_image([x as f64, y as f64]);
                let expected = (u - 0.5) / 100.0 + (v - 0.5) / 1000.0;
                let sample = f64::from(tensor.data[y * width + x]);
                assert!((sample - expected).abs() < 2e-4, "{fixed:?} {height}: {sample} {expected}");
            }
            assert!(placement.inside([placement.offset[0], placement.offset[1]], 0));
        }
    }

    #[test]
    fn uniform_image_has_no_nan() {
        let gray = GrayImage::new(16, 16, vec![0.5; 256]).expect("whole rows");
        let input = Input { normalize: Normalize::Image, ..input(2, 8, None) };
        assert!(prepare(&gray, &input, None).0.data.iter().all(|sample| sample.abs() < 1e-6));
        let (tensor, _) = prepare(&ramp(30, 30), &input, Some([30, 30]));
        let mean: f32 = tensor.data.iter().sum::<f32>() / tensor.data.len() as f32;
        assert!(mean.abs() < 0.2, "{mean}");
    }
}
