//! A distance of features that needs no network trained on classes: layers of SuperPoint's encoder.

use std::path::Path;

use crate::AttackError;
use crate::image_metrics::layers::mean_over_pixels;
use crate::image_metrics::size::one_size;
use veiloc_features::FeatureError;
use veiloc_features::learned::{Backbone, Tensor, Weights, WeightsError};
use veiloc_features::{ColourImage, GrayImage};

/// Two images through SuperPoint's encoder: one minus the cosine between a pixel's channels in both, averaged over the pixels of
/// a layer, and over four layers.
///
/// Of LPIPS's form, but nothing in it was fitted to what people call alike, and the network learned corners and not classes: its
/// numbers are not those of LPIPS and do not compare with them. 0 for equal images, 1 where no feature is shared.
#[derive(Debug)]
pub struct FeatureDistance(Backbone);

impl FeatureDistance {
    /// Reads the weights: `superpoint_v1.pth`, or a `.npz` with the encoder's tensors under the same names.
    ///
    /// # Errors
    /// [`AttackError::Features`] when the file cannot be read or is of another network.
    pub fn open(path: &Path) -> Result<Self, AttackError> {
        let weights = Weights::open(path)?;
        let unfit = |source| FeatureError::Weights { path: path.to_owned(), source: Box::new(source) };
        Ok(Self::new(&weights).map_err(unfit)?)
    }

    /// Of weights that were read.
    ///
    /// # Errors
    /// [`WeightsError`] when they are of another network.
    pub fn new(weights: &Weights) -> Result<Self, WeightsError> {
        Ok(Self(Backbone::superpoint(weights)?))
    }

    /// The distance.
    ///
    /// # Errors
    /// [`AttackError::Sizes`], [`AttackError::Small`] for an image with less than 8 pixels, [`AttackError::Features`].
    pub fn between(&self, a: &ColourImage, b: &ColourImage) -> Result<f64, AttackError> {
        let size = one_size(a, b)?;
        if size[0] < 8 || size[1] < 8 {
            return Err(AttackError::Small { size, least: 8 });
        }
        let layers = |image: &ColourImage| {
            let gray = GrayImage::from_rgb8(image.width(), image.height(), image.data());
            let data = gray.map(|gray| gray.data().to_vec()).unwrap_or_default();
            self.0.layers(&Tensor { shape: vec![1, 1, size[1], size[0]], data })
        };
        let (own, other) = (layers(a)?, layers(b)?);
        let apart = |x: &[f32], y: &[f32]| {
            let cosine: f32 = x.iter().zip(y).map(|(x, y)| x * y).sum();
            // Where neither has any feature they do not differ.
            let none = |v: &[f32]| v.iter().all(|v| *v == 0.0);
            if none(x) && none(y) { 0.0 } else { f64::from(1.0 - cosine).max(0.0) }
        };
        let each = own.iter().zip(&other).map(|(x, y)| mean_over_pixels(x, y, apart));
        Ok(each.sum::<f64>() / own.len() as f64)
    }
}
