//! Similarity of two images of one size, and recognisability of their content.
//!
//! | measure | what it compares | range |
//! |---|---|---|
//! | [`psnr`] | pixels | decibels, infinite for equal images |
//! | [`ssim`] | mean, spread and correlation in small windows | to 1 for equal images |
//! | [`PerceptualDistance`] | ST-LPIPS: layers of a network, weighted by human judgements | from 0 for equal images |
//! | [`Classifier`] | the class predicted by an ImageNet network | right or wrong |
//!
//! PSNR and SSIM agree with scikit-image to all printed digits (`research/oracles/image_metrics.py`). The two networks are ONNX
//! files that the user provides; `scripts/export_onnx.py` exports them from their authors' files.
#![forbid(unsafe_code)]

mod classifier;
mod perceptual;
mod psnr;
mod size;
mod ssim;

use std::path::{Path, PathBuf};

use veiloc_features::FeatureError;
use veiloc_features::learned::{Engine, Network, Tensor};

use crate::AttackError;

pub use classifier::{Classifier, class_named};
pub use perceptual::PerceptualDistance;
pub use psnr::psnr;
pub use ssim::ssim;

/// A network of an image metric.
#[derive(Debug)]
struct MetricNetwork {
    path: PathBuf,
    network: Network,
}

impl MetricNetwork {
    /// Reads a network that has exactly these inputs, and this output.
    fn open(path: &Path, inputs: &[&str], output: &str) -> Result<Self, AttackError> {
        let network = Self { path: path.to_owned(), network: Network::open(path, Engine::default())? };
        let [count, _] = network.network.ends();
        let lacks = inputs.iter().any(|name| network.network.input_named(name).is_none());
        if count != inputs.len() || lacks || network.network.outputs().iter().all(|own| own != output) {
            let reason = format!("it must have the inputs {inputs:?} and the output {output:?}");
            return Err(network.unusable(reason));
        }
        Ok(network)
    }

    /// The values of its output: `expected` many, all finite.
    fn run(
        &self,
        inputs: &[(&str, &Tensor)],
        output: &str,
        expected: usize,
    ) -> Result<Vec<f32>, AttackError> {
        let results = self.network.run_named(inputs, &[output]).map_err(|error| match error {
            FeatureError::NetworkRun { reason } => self.unusable(reason),
            other => other.into(),
        })?;
        let numbers = results.into_iter().next().map(|result| result.data).unwrap_or_default();
        if numbers.len() != expected || numbers.iter().any(|number| !number.is_finite()) {
            return Err(self.unusable(format!("its output {output:?} is not {expected} finite numbers")));
        }
        Ok(numbers)
    }

    fn unusable(&self, reason: String) -> AttackError {
        FeatureError::Network { path: self.path.clone(), reason }.into()
    }
}
