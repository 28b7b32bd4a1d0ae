//! A second network that makes the descriptors: it samples a layer of the first one at the keypoints.

use std::path::Path;

use crate::FeatureError;
use crate::learned::keypoints::Peak;
use crate::learned::sample::normalize;
use crate::learned::{Engine, Network, Tensor};

/// Names of its inputs, the layer and the keypoints, and of its output.
const INPUTS: [&str; 2] = ["features", "keypoints"];
const OUTPUT: &str = "descriptors";

/// A descriptor head as a file of its own, as networks with offsets for each keypoint have it (ALIKED).
pub(crate) struct Head(Network);

impl Head {
    /// # Errors
    /// [`FeatureError`] for a missing or damaged file, and for a network with other inputs or outputs.
    pub(crate) fn open(file: &Path, engine: Engine) -> Result<Self, FeatureError> {
        let network = Network::open(file, engine)?;
        let known = INPUTS.iter().all(|name| network.input_named(name).is_some());
        if !known || network.ends()[0] != INPUTS.len() || !network.outputs().iter().any(|own| own == OUTPUT) {
            let reason = format!("a head has the inputs {} and the output {OUTPUT}", INPUTS.join(" and "));
            return Err(FeatureError::Network { path: file.to_owned(), reason });
        }
        Ok(Self(network))
    }

    /// Descriptors of length 1 at these peaks. `[N, numbers]`
    ///
    /// # Errors
    /// [`FeatureError::NetworkRun`], also for a result of another shape or with NaN or infinity.
    pub(crate) fn descriptors(
        &self,
        layer: &Tensor,
        peaks: &[Peak],
        numbers: usize,
    ) -> Result<Vec<f32>, FeatureError> {
        if peaks.is_empty() {
            return Ok(Vec::new());
        }
        let data = peaks.iter().flat_map(|peak| peak.position.map(|at| at as f32)).collect();
        let keypoints = Tensor { shape: vec![1, peaks.len(), 2], data };
        let given = [(INPUTS[0], layer), (INPUTS[1], &keypoints)];
        let found = self.0.run_named(&given, &[OUTPUT])?.pop().expect("one result for each output");
        if found.shape != [1, peaks.len(), numbers] || found.data.iter().any(|number| !number.is_finite()) {
            let reason = format!("its head gives {:?} instead of {numbers} finite numbers each", found.shape);
            return Err(FeatureError::NetworkRun { reason });
        }
        let mut vectors = found.data;
        vectors.chunks_exact_mut(numbers).for_each(normalize);
        Ok(vectors)
    }
}
