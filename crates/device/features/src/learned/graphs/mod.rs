//! Networks whose files hold tensors and no graph: their layers, as their papers' programs have them.

mod alike;
mod backbone;
mod netvlad;
mod superpoint;

use crate::learned::{Weights, WeightsError};

pub use backbone::Backbone;

pub(crate) use alike::{Head, LEVELS};
pub(crate) use netvlad::{FEATURES, NetVlad, netvlad};

/// Which layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Graph {
    /// DeTone et al., *SuperPoint*, CVPR workshops 2018.
    Superpoint,
    /// Zhao et al., *ALIKE*, IEEE Transactions on Multimedia 2022.
    Alike,
}

/// A graph with its weights, as ONNX, and what of the weights is used beside it.
pub(crate) struct Made {
    pub(crate) onnx: Vec<u8>,
    /// The last layer of a network that is computed at keypoints alone.
    pub(crate) head: Option<Head>,
}

impl Graph {
    pub(crate) fn of(self, weights: &Weights) -> Result<Made, WeightsError> {
        match self {
            Self::Superpoint => Ok(Made { onnx: superpoint::onnx(weights)?, head: None }),
            Self::Alike => alike::made(weights),
        }
    }
}
