//! The input of a detector: the image scaled to fit, centred on gray, colours from 0 to 1, `[3, height, width]`.

use crate::ColourImage;

/// Gray of the padding, as in YOLO's training.
const GROUND: f32 = 114.0 / 255.0;

/// Position of the image in the detector's input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Placement {
    /// Scale from the image to the detector's input, along both axes.
    scale: f32,
    /// Left and upper border, pixels of the detector's input.
    offset: [f32; 2],
}

impl Placement {
    /// Transforms a position of the detector's input to the image file.
    pub(crate) fn to_file(self, [x, y]: [f32; 2]) -> [f32; 2] {
        [(x - self.offset[0]) / self.scale, (y - self.offset[1]) / self.scale]
    }
}

/// Samples `[3, height, width]`, and the position of the image in them. Linear interpolation.
pub(crate) fn letterbox(image: &ColourImage, [width, height]: [usize; 2]) -> (Vec<f32>, Placement) {
    let (own_width, own_height) = (image.width() as usize, image.height() as usize);
    let scale = (width as f32 / own_width as f32).min(height as f32 / own_height as f32);
    let fitted = |side: usize, most: usize| ((side as f32 * scale).round() as usize).clamp(1, most);
    let (inner_width, inner_height) = (fitted(own_width, width), fitted(own_height, height));
    let (left, upper) = ((width - inner_width) / 2, (height - inner_height) / 2);
    let across = axis(own_width, inner_width);
    let down = axis(own_height, inner_height);
    let mut samples = vec![GROUND; 3 * width * height];
    let data = image.data();
    for (y, (above, below, share_down)) in down.iter().enumerate() {
        for (x, (before, behind, share_across)) in across.iter().enumerate() {
            for channel in 0..3 {
                let at =
                    |row: &usize, column: &usize| f32::from(data[(row * own_width + column) * 3 + channel]);
                let mix = |a: f32, b: f32, share: &f32| a + (b - a) * share;
                let value = mix(
                    mix(at(above, before), at(above, behind), share_across),
                    mix(at(below, before), at(below, behind), share_across),
                    share_down,
                );
                samples[(channel * height + upper + y) * width + left + x] = value / 255.0;
            }
        }
    }
    (samples, Placement { scale, offset: [left as f32, upper as f32] })
}

/// For each new pixel the two old ones around its centre, and the weight of the second.
fn axis(old: usize, new: usize) -> Vec<(usize, usize, f32)> {
    let step = old as f32 / new as f32;
    (0..new)
        .map(|i| {
            let at = ((i as f32 + 0.5) * step - 0.5).clamp(0.0, old as f32 - 1.0);
            let first = at as usize;
            (first, (first + 1).min(old - 1), at - first as f32)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_image_is_centred_with_padding() {
        // Red increases to the right, blue downwards.
        let pixels = (0..20).flat_map(|y| (0..40).flat_map(move |x| [(6 * x) as u8, 0, (12 * y) as u8]));
        let image = ColourImage::new(40, 20, pixels.collect()).expect("whole rows");
        let (samples, placement) = letterbox(&image, [20, 20]);
        let at = |channel: usize, x: usize, y: usize| samples[(channel * 20 + y) * 20 + x];
        assert_eq!((at(0, 3, 4), at(1, 19, 15)), (GROUND, GROUND));
        // The centre of new pixel 3 lies between old ones 6 and 7; that of row 7, the third of the image, between 4 and
        // 5.
        assert!((at(0, 3, 7) - 6.5 * 6.0 / 255.0).abs() < 1e-5 && at(1, 3, 7) == 0.0);
        assert!((at(2, 3, 7) - 4.5 * 12.0 / 255.0).abs() < 1e-5);
        assert_eq!(placement.to_file([3.5, 7.5]), [7.0, 5.0]);
        assert_eq!(placement.to_file([0.0, 5.0]), [0.0, 0.0]);
    }
}
