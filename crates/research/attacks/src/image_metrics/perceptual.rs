//! A perceptual distance computed by a network.

use std::path::Path;

use veiloc_features::ColourImage;
use veiloc_features::learned::Tensor;

use super::MetricNetwork;
use super::size::one_size;
use crate::AttackError;

/// ST-LPIPS, exported as one network.
///
/// Ghildyal and Liu, *Shift-tolerant Perceptual Similarity Metric*, ECCV 2022: LPIPS (Zhang et al., CVPR 2018) with
/// layers that are almost invariant to a shift by a pixel. Its values are not comparable with LPIPS.
///
/// ```text
/// a, b [1, 3, H, W], red, green and blue, sRGB from 0 to 1 → distance, one number
/// ```
#[derive(Debug)]
pub struct PerceptualDistance(MetricNetwork);

impl PerceptualDistance {
    /// Reads the network, an ONNX file.
    ///
    /// # Errors
    /// [`AttackError::Features`], with the file's name.
    pub fn open(path: &Path) -> Result<Self, AttackError> {
        MetricNetwork::open(path, &["a", "b"], "distance").map(Self)
    }

    /// The distance, 0 for equal images.
    ///
    /// # Errors
    /// [`AttackError::Sizes`], and [`AttackError::Features`] when the network cannot run, for example on images that
    /// are too small.
    pub fn between(&self, a: &ColourImage, b: &ColourImage) -> Result<f64, AttackError> {
        let [width, height] = one_size(a, b)?;
        let tensor = |image: &ColourImage| {
            let samples = |colour| image.data().iter().skip(colour).step_by(3).map(|v| f32::from(*v) / 255.0);
            Tensor { shape: vec![1, 3, height, width], data: (0..3).flat_map(samples).collect() }
        };
        let distance = self.0.run(&[("a", &tensor(a)), ("b", &tensor(b))], "distance", 1)?;
        Ok(f64::from(distance[0]))
    }
}
