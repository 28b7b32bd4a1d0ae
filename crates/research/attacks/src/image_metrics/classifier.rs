//! Image classification by an ImageNet network.

use std::path::Path;

use veiloc_features::ColourImage;
use veiloc_features::learned::Tensor;

use super::MetricNetwork;
use crate::AttackError;

/// ImageNet's classes in the order of the networks' outputs: their WordNet synsets.
const SYNSETS: &str = include_str!("synsets.txt");
/// Number of classes.
const CLASSES: usize = 1000;
/// Side of the network's input, pixels.
const SIDE: usize = 224;
/// Relative size of the central crop, along the shorter side: EfficientNet's.
const CROP_SHARE: f64 = 0.875;
/// Offset and divisor of a byte: EfficientNet-Lite's.
const SHIFT: f32 = 127.0;
const SCALE: f32 = 128.0;

/// An ImageNet classifier: EfficientNet-Lite0 as it is exported.
///
/// ```text
/// image [1, 3, 224, 224], red, green and blue, (byte − 127) / 128 → logits [1, 1000]
/// ```
#[derive(Debug)]
pub struct Classifier(MetricNetwork);

impl Classifier {
    /// Reads the network, an ONNX file.
    ///
    /// # Errors
    /// [`AttackError::Features`], with the file's name.
    pub fn open(path: &Path) -> Result<Self, AttackError> {
        MetricNetwork::open(path, &["image"], "logits").map(Self)
    }

    /// The five likeliest classes of the central crop of an image, likeliest first; ties are ordered by number.
    ///
    /// # Errors
    /// [`AttackError::Features`] when the network cannot run.
    pub fn classes(&self, image: &ColourImage) -> Result<Vec<usize>, AttackError> {
        let data = center_crop(image).into_iter().map(|value| (value - SHIFT) / SCALE).collect();
        let tensor = Tensor { shape: vec![1, 3, SIDE, SIDE], data };
        let logits = self.0.run(&[("image", &tensor)], "logits", CLASSES)?;
        let mut order: Vec<usize> = (0..CLASSES).collect();
        order.sort_by(|a, b| logits[*b].total_cmp(&logits[*a]).then(a.cmp(b)));
        order.truncate(5);
        Ok(order)
    }
}

/// The class whose synset starts the name of a file or of its folder (`n01440764_tench.jpg`), or `None`.
pub fn class_named(path: &Path) -> Option<usize> {
    let of = |path: &Path| {
        let synset = path.file_name()?.to_str()?.get(..9)?;
        SYNSETS.lines().position(|own| own == synset)
    };
    of(path).or_else(|| of(path.parent()?))
}

/// The central square at the network's input size, `[3, SIDE, SIDE]` bytes: triangle filter whose width is one
/// step, at least two pixels.
fn center_crop(image: &ColourImage) -> Vec<f32> {
    let [width, height] = [image.width(), image.height()].map(|side| side as usize);
    let square = CROP_SHARE * width.min(height) as f64;
    let weights = |side: usize| -> Vec<Vec<(usize, f32)>> {
        let first = (side as f64 - square) / 2.0;
        (0..SIDE).map(|at| triangle_filter(first, square / SIDE as f64, at, side)).collect()
    };
    let (columns, rows) = (weights(width), weights(height));
    let mut out = Vec::with_capacity(3 * SIDE * SIDE);
    for colour in 0..3 {
        // The horizontal filter runs only on rows that the result needs.
        let narrow = |y: usize, column: &[(usize, f32)]| -> f32 {
            column.iter().map(|(x, w)| w * f32::from(image.data()[3 * (y * width + x) + colour])).sum()
        };
        for row in &rows {
            for column in &columns {
                out.push(row.iter().map(|(y, w)| w * narrow(*y, column)).sum());
            }
        }
    }
    out
}

/// Pixels of a side with their weights, which sum to one, for one sample of a grid with this step.
fn triangle_filter(first: f64, step: f64, at: usize, side: usize) -> Vec<(usize, f32)> {
    let reach = step.max(1.0);
    let centre = first + (at as f64 + 0.5) * step;
    let weight = |pixel: usize| (1.0 - (pixel as f64 + 0.5 - centre).abs() / reach).max(0.0);
    let (near, far) = ((centre - reach - 0.5).max(0.0) as usize, (centre + reach + 0.5) as usize);
    let own: Vec<(usize, f64)> = (near..=far.min(side.saturating_sub(1)))
        .map(|pixel| (pixel, weight(pixel)))
        .filter(|(_, weight)| *weight > 0.0)
        .collect();
    let whole: f64 = own.iter().map(|(_, weight)| weight).sum();
    own.into_iter().map(|(pixel, weight)| (pixel, (weight / whole) as f32)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn class_is_read_from_file_or_folder_name() {
        assert_eq!(SYNSETS.lines().count(), CLASSES);
        assert!(SYNSETS.lines().is_sorted());
        for (path, class) in [
            ("n01440764_tench.jpg", Some(0)),
            ("photos/n15075141_toilet_tissue.jpg", Some(999)),
            ("n01443537/5.png", Some(1)),
            ("n00000000_nothing.jpg", None),
            ("street.jpg", None),
            ("n01440764/street/5.jpg", None),
            ("/", None),
            ("übermütig.jpg", None),
        ] {
            assert_eq!(class_named(Path::new(path)), class, "{path}");
        }
    }

    #[test]
    fn center_crop_is_classified() {
        // A gray ramp that rises by one from column to column: it stays a ramp at any size.
        for [width, height] in [[512, 256], [64, 100], [224, 224], [1, 1]] {
            let pixels = (0..width * height).flat_map(|i| [(i % width / 4) as u8 * 2; 3]).collect();
            let image = ColourImage::new(width, height, pixels).expect("three bytes a pixel");
            let samples = center_crop(&image);
            assert_eq!(samples.len(), 3 * SIDE * SIDE);
            let square = CROP_SHARE * f64::from(width.min(height));
            let expected = |x: usize| {
                let at = (f64::from(width) - square) / 2.0 + (x as f64 + 0.5) / SIDE as f64 * square;
                ((at - 2.0) / 2.0).max(0.0) as f32
            };
            for x in [0, 50, 223] {
                let (own, expected) = (samples[SIDE * 100 + x], expected(x));
                assert!(width == 1 || (own - expected).abs() < 1.5, "{width} {x}: {own} {expected}");
            }
        }
    }
}
