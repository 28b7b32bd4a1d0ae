//! Position networks: from all rows of one obfuscated image to the position of each keypoint on its line.
//!
//! The input for a row is its descriptor and the bins of its line, each with its exact prior probability. The
//! network's output for a bin is **added to the log prior**. So a network that outputs zeros gives exactly the
//! prior-only baseline, under any scheme and layout; every difference from it was learned.
//!
//! ```text
//! descriptors [1, N, dimension]
//! places      [1, N, B, 2]       (u − w/2) / max(w, h) + 1/2 and (v − h/2) / max(w, h) + 1/2 of each bin
//! guess       [1, N, B]          log prior of the bin; rows with fewer bins repeat the last position with −1e9
//! → logits    [1, N, B]          log p(bin b of row i) = guess_i(b) + logits_i(b) + constant
//! ```

mod accuracy;
mod bins;
mod recover;

use std::path::Path;

use veiloc_features::learned::Tensor;
use veiloc_protocol::Scheme;

use super::description::{DescribedNetwork, NetworkKind};
use super::rows;
use crate::{AttackError, DecodedDescriptors, Observation};

use super::description::InputModality;
pub use accuracy::{PositionAccuracy, position_accuracy};
pub use recover::{PositionEstimate, recover};

use bins::Bins;

/// Log prior of padding bins.
const NO_BIN: f32 = -1e9;

/// Predicts the position of each keypoint on its line.
#[derive(Debug)]
pub struct PositionNetwork {
    network: DescribedNetwork,
    scheme: Scheme,
    input: InputModality,
}

impl PositionNetwork {
    /// Reads a network from its description, or from the ONNX file beside it.
    ///
    /// # Errors
    /// [`AttackError::Description`] and [`AttackError::Features`], with the file's name.
    pub fn open(path: &Path) -> Result<Self, AttackError> {
        let (network, description) = DescribedNetwork::open(path, NetworkKind::Positions)?;
        let name = description.scheme.unwrap_or_default();
        let scheme: Scheme = name
            .parse()
            .map_err(|error| network.description_error(format!("its scheme is {name:?}: {error}")))?;
        if !scheme.hides_positions() {
            return Err(network.description_error(format!(
                "its scheme, {name}, sends positions openly, so there is nothing to predict"
            )));
        }
        let input = description.input.unwrap_or(InputModality::Set);
        let inputs: [(&str, &[Option<usize>]); 3] = [
            ("descriptors", &[Some(1), None, Some(network.dimension())]),
            ("places", &[Some(1), None, None, Some(2)]),
            ("guess", &[Some(1), None, None]),
        ];
        network.check(&inputs, &["logits"])?;
        Ok(Self { network, scheme, input })
    }

    /// The descriptor kind of its training data.
    pub fn features(&self) -> &str {
        self.network.features()
    }

    /// The scheme of its training data; it cannot be used on other schemes.
    pub fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// Its input modality.
    pub fn input_modality(&self) -> InputModality {
        self.input
    }

    /// Posterior probability of each bin of each row, `[bins]`.
    fn shares(
        &self,
        descriptors: &DecodedDescriptors,
        bins: &Bins,
        size: [u32; 2],
    ) -> Result<Vec<f32>, AttackError> {
        let count = bins.rows();
        let most = (0..count).map(|row| bins.of_row(row).len()).max().unwrap_or(0);
        if most == 0 {
            return Ok(Vec::new());
        }
        let [width, height] = size.map(f64::from);
        let longer = width.max(height).max(1.0);
        let mut places = Tensor { shape: vec![1, count, most, 2], data: Vec::new() };
        let mut guess = Tensor { shape: vec![1, count, most], data: Vec::new() };
        for row in 0..count {
            let own = bins.of_row(row);
            for bin in 0..most {
                let at = own.start + bin.min(own.len() - 1);
                let position = bins.positions[at];
                let along = |at: f64, side: f64| ((at - side / 2.0) / longer + 0.5) as f32;
                places.data.extend([along(position.u, width), along(position.v, height)]);
                guess.data.push(if bin < own.len() { bins.log_prior[at] } else { NO_BIN });
            }
        }
        let sides = [Some(1), Some(count), Some(most)];
        let descriptors = rows(descriptors);
        let given = [("descriptors", &descriptors), ("places", &places), ("guess", &guess)];
        let logits = self.network.run(&given, &[("logits", &sides)])?.remove(0);
        let mut shares = bins.log_prior.clone();
        for (row, logits) in logits.data.chunks_exact(most).enumerate() {
            let own = &mut shares[bins.of_row(row)];
            own.iter_mut().zip(logits).for_each(|(share, logit)| *share += logit);
            softmax(own);
        }
        Ok(shares)
    }
}

/// Converts logits to probabilities.
fn softmax(values: &mut [f32]) {
    let most = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    for x in values.iter_mut() {
        *x = (*x - most).exp();
    }
    let whole: f32 = values.iter().sum();
    for x in values.iter_mut() {
        *x /= whole;
    }
}

/// Whether the row can have been sent under this scheme.
fn fits(scheme: Scheme, observation: &Observation) -> bool {
    match observation {
        Observation::Line(_) => scheme == Scheme::RandomLines,
        Observation::EitherLine(_) => scheme == Scheme::CoordinatePermutation,
        Observation::Pencil(_) => matches!(scheme, Scheme::Dcl(_)),
        Observation::Known(_) => true,
    }
}

#[cfg(test)]
mod tests {
    use veiloc_geometry::PixelLine;

    use super::*;

    /// The network of `research/oracles/tiny_networks.py`: the logits depend on each bin's distance from the centre of a
    /// field.
    #[test]
    fn posterior_is_prior_times_network_output() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/learned/positions.toml");
        let network = PositionNetwork::open(&path).expect("a network");
        let size = [320, 240];
        // Rows with different numbers of bins: a line, a known position, and two lines.
        let line = |u, v, angle| PixelLine::through(veiloc_geometry::Pixel::new(u, v), angle);
        let rows = [
            Observation::Line(line(30.0, 70.0, 0.3)),
            Observation::Known(veiloc_geometry::Pixel::new(200.0, 20.0)),
            Observation::EitherLine([line(90.0, 100.0, 0.0), line(90.0, 100.0, 1.57)]),
        ];
        let fields = [4, 0, 11];
        let bytes: Vec<u8> = fields.iter().flat_map(|f| (0..12).map(move |i| u8::from(i == *f))).collect();
        let descriptors = DecodedDescriptors::new(&bytes, 12).expect("three");
        let bins = Bins::of(&rows, size, 20);
        let shares = network.shares(&descriptors, &bins, size).expect("it runs");
        for (row, field) in fields.iter().enumerate() {
            let middle = [(80 * (field % 4) + 40) as f64, (80 * (field / 4) + 40) as f64];
            let own = bins.of_row(row);
            let odds: Vec<f64> = own
                .clone()
                .map(|bin| {
                    let (position, prior) = (bins.positions[bin], f64::from(bins.log_prior[bin]).exp());
                    let square = (position.u - middle[0]).powi(2) + (position.v - middle[1]).powi(2);
                    prior * (-50.0 * square / 320.0 / 320.0 + prior).exp()
                })
                .collect();
            let whole: f64 = odds.iter().sum();
            for (share, odds) in shares[own].iter().zip(&odds) {
                assert!(
                    (f64::from(*share) - odds / whole).abs() < 1e-5,
                    "row {row}: {share} {}",
                    odds / whole
                );
            }
        }
    }
}
