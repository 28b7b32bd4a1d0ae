//! Networks of positions that attack: read from their files, one for each scheme that has one.

use std::path::PathBuf;

use veiloc_attacks::{Descriptors, Observation};
use veiloc_geometry::Pixel;
use veiloc_protocol::Scheme;

use crate::EvalError;

/// What an outsider has trained, see `veiloc train positions`.
#[derive(Debug, Default)]
pub struct TrainedPositions {
    networks: Vec<veiloc_attacks::learned::positions::PositionNetwork>,
}

impl TrainedPositions {
    /// From their files.
    ///
    /// # Errors
    /// [`EvalError`] when a file is no network, or there are two of one scheme.
    pub fn read(files: &[PathBuf]) -> Result<Self, EvalError> {
        let mut networks: Vec<veiloc_attacks::learned::positions::PositionNetwork> = Vec::new();
        for file in files {
            let fault = |why: String| EvalError::DataSet(format!("{}: {why}", file.display()));
            let bytes = std::fs::read(file).map_err(|source| EvalError::Io { path: file.clone(), source })?;
            let network = veiloc_attacks::learned::positions::PositionNetwork::decode(&bytes)
                .map_err(|e| fault(e.to_string()))?;
            if networks.iter().any(|other| other.scheme() == network.scheme()) {
                return Err(fault(format!("another network of {} is given too", network.scheme())));
            }
            networks.push(network);
        }
        Ok(Self { networks })
    }

    /// Whether there is one for this scheme.
    pub fn knows(&self, scheme: Scheme) -> bool {
        self.networks.iter().any(|n| n.scheme() == scheme)
    }

    /// Where the network of this scheme puts each keypoint, `[N]`; `None` where there is none.
    pub(crate) fn recover(
        &self,
        scheme: Scheme,
        observations: &[Observation],
        descriptors: &Descriptors,
        (width, height): (u32, u32),
    ) -> Result<Option<Vec<Pixel>>, EvalError> {
        let Some(network) = self.networks.iter().find(|n| n.scheme() == scheme) else { return Ok(None) };
        let found =
            veiloc_attacks::learned::positions::recover(network, observations, descriptors, width, height)?;
        Ok(Some(found.iter().map(|e| e.pixel).collect()))
    }
}
