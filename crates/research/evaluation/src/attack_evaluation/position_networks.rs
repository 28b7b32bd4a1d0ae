//! Learned position attacks: one network per scheme.

use std::path::PathBuf;

use veiloc_attacks::learned::positions::{PositionNetwork, recover};
use veiloc_attacks::{DecodedDescriptors, Observation};
use veiloc_datasets::problem_files::KeypointImage;
use veiloc_geometry::Pixel;
use veiloc_protocol::Scheme;

use super::neighbours::check_features;
use crate::EvalError;

/// Position networks trained by a query-only adversary.
#[derive(Debug, Default)]
pub(super) struct PositionNetworks {
    networks: Vec<PositionNetwork>,
}

impl PositionNetworks {
    /// Reads the networks from their description files, at most one per scheme.
    pub(super) fn read(files: &[PathBuf]) -> Result<Self, EvalError> {
        let mut networks: Vec<PositionNetwork> = Vec::new();
        for file in files {
            let network = PositionNetwork::open(file)?;
            if networks.iter().any(|other| other.scheme() == network.scheme()) {
                let (file, scheme) = (file.display(), network.scheme());
                return Err(EvalError::DataSet(format!(
                    "{file}: two networks are given for {scheme}; give one per scheme"
                )));
            }
            networks.push(network);
        }
        Ok(Self { networks })
    }

    /// Whether there is a network for this scheme.
    pub(super) fn knows(&self, scheme: Scheme) -> bool {
        self.networks.iter().any(|n| n.scheme() == scheme)
    }

    /// Refuses images whose descriptors are of a kind that a network was not trained on.
    pub(super) fn check_features(&self, images: &[&KeypointImage]) -> Result<(), EvalError> {
        self.networks.iter().try_for_each(|network| check_features(images, network.features()))
    }

    /// Positions from the network of this scheme, `[N]`; `None` if there is none.
    pub(super) fn recover(
        &self,
        scheme: Scheme,
        observations: &[Observation],
        descriptors: &DecodedDescriptors,
        (width, height): (u32, u32),
    ) -> Result<Option<Vec<Pixel>>, EvalError> {
        let Some(network) = self.networks.iter().find(|n| n.scheme() == scheme) else { return Ok(None) };
        let found = recover(network, observations, descriptors, width, height)?;
        Ok(Some(found.iter().map(|e| e.pixel).collect()))
    }
}
