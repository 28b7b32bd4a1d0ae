//! LPIPS, version 0.1.
//!
//! Zhang et al., *The Unreasonable Effectiveness of Deep Features as a Perceptual Metric*, CVPR 2018; reference implementation:
//! `lpips.LPIPS(net=…, version='0.1')`. Both images from −1 to 1 are normalized, pass the network, and at each of five layers a
//! pixel's channels get length 1; squared differences are weighted, summed over channels, averaged over pixels, summed over
//! layers.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::AttackError;
use crate::image_metrics::layers::mean_over_pixels;
use crate::image_metrics::size::one_size;
use veiloc_features::ColourImage;
use veiloc_features::FeatureError;
use veiloc_features::learned::{Backbone, Tensor, Weights, WeightsError};

/// What is taken off red, green and blue, and what they are divided by.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// Which network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LpipsNetwork {
    /// AlexNet, what LPIPS's authors recommend and most papers report.
    Alex,
    /// VGG16.
    Vgg,
}

impl FromStr for LpipsNetwork {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "alex" => Ok(Self::Alex),
            "vgg" => Ok(Self::Vgg),
            _ => Err(format!("LPIPS has the networks alex and vgg here, not {text:?}")),
        }
    }
}

/// The measure with its weights.
#[derive(Debug)]
pub struct Lpips {
    backbone: Backbone,
    /// By layer, one number a channel.
    weights: Vec<Vec<f32>>,
}

impl Lpips {
    /// Reads torchvision's file of the network (`alexnet-owt-….pth`, `vgg16-….pth`) and LPIPS's own weights (`alex.pth`, or the
    /// same as `.npz`).
    ///
    /// # Errors
    /// [`AttackError::Features`] when a file cannot be read or is of another network.
    pub fn open(network: LpipsNetwork, backbone: &Path, linear: &Path) -> Result<Self, AttackError> {
        let unfit = |path: &Path| {
            let path = PathBuf::from(path);
            move |source: WeightsError| FeatureError::Weights { path, source: Box::new(source) }
        };
        let weights = Weights::open(backbone)?;
        let read = match network {
            LpipsNetwork::Alex => Backbone::alexnet(&weights),
            LpipsNetwork::Vgg => Backbone::vgg16(&weights),
        };
        let network = read.map_err(unfit(backbone))?;
        let own = Weights::open(linear)?;
        Ok(Self::new(network, &own).map_err(unfit(linear))?)
    }

    /// Of a network and LPIPS's own weights, `lin0.model.1.weight` to `lin4.model.1.weight`, `[1, channels, 1, 1]` each.
    ///
    /// # Errors
    /// [`WeightsError`] when those are of another network.
    pub fn new(backbone: Backbone, linear: &Weights) -> Result<Self, WeightsError> {
        let of = |(layer, channels): (usize, &usize)| {
            let tensor = linear.get(&format!("lin{layer}.model.1.weight"), &[1, *channels, 1, 1])?;
            Ok(tensor.data.clone())
        };
        let weights = backbone.channels().iter().enumerate().map(of).collect::<Result<_, WeightsError>>()?;
        Ok(Self { backbone, weights })
    }

    /// The distance, 0 for equal images.
    ///
    /// # Errors
    /// [`AttackError::Sizes`], and [`AttackError::Features`] for images so small that nothing is left of them.
    pub fn between(&self, a: &ColourImage, b: &ColourImage) -> Result<f64, AttackError> {
        let [width, height] = one_size(a, b)?;
        let layers = |image: &ColourImage| {
            let mut data = Vec::with_capacity(image.data().len());
            for colour in 0..3 {
                let samples = image.data().iter().skip(colour).step_by(3);
                data.extend(samples.map(|v| (f32::from(*v) / 127.5 - 1.0 - SHIFT[colour]) / SCALE[colour]));
            }
            self.backbone.layers(&Tensor { shape: vec![1, 3, height, width], data })
        };
        let (own, other) = (layers(a)?, layers(b)?);
        let each = own.iter().zip(&other).zip(&self.weights).map(|((x, y), weights)| {
            mean_over_pixels(x, y, |x, y| {
                let parts = x.iter().zip(y).zip(weights);
                parts.map(|((x, y), w)| f64::from(w * (x - y) * (x - y))).sum()
            })
        });
        Ok(each.sum())
    }
}
