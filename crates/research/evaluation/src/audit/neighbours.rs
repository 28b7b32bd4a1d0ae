//! Who tells the attacker which keypoints are neighbours: an oracle, a predictor, or a map.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;
use veiloc_attacks::learned::neighbours::NeighbourNetwork;
use veiloc_attacks::{
    AttackError, Descriptors, KnownImage, NeighbourLists, NeighbourPredictor, Transfer, transfer,
};
use veiloc_datasets::problem_files::{KeypointImage, read_keypoints};

use crate::EvalError;

/// Who tells the attacker which keypoints are neighbours.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NeighbourSource {
    /// An oracle that knows the positions: the worst case.
    Oracle,
    /// A statistic of which descriptors occur side by side, learned from the images of these files. Images named
    /// as one that is attacked are left out.
    Predicted {
        /// Files of keypoints with descriptors.
        train: Vec<PathBuf>,
    },
    /// A trained network ([`veiloc_attacks::learned::neighbours`]).
    Network {
        /// The file of its description.
        model: PathBuf,
    },
    /// The other images of the same file, taken for the map of a server: keypoints whose matches are near each
    /// other there.
    Transferred,
}

/// A [`NeighbourSource`] without its files, as documents name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Neighbours {
    /// An oracle that knows the positions.
    #[default]
    Oracle,
    /// A statistic of descriptors.
    Predicted,
    /// A trained network.
    Network,
    /// Map images.
    Transferred,
}

impl fmt::Display for Neighbours {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Oracle => "oracle",
            Self::Predicted => "predicted",
            Self::Network => "network",
            Self::Transferred => "transferred",
        })
    }
}

/// Map images whose positions and neighbours are taken over, those with most mutual matches.
const MAP_IMAGES: usize = 5;

impl NeighbourSource {
    /// Which of the sources it is.
    pub const fn kind(&self) -> Neighbours {
        match self {
            Self::Oracle => Neighbours::Oracle,
            Self::Predicted { .. } => Neighbours::Predicted,
            Self::Network { .. } => Neighbours::Network,
            Self::Transferred => Neighbours::Transferred,
        }
    }

    /// The predictor, where there is one, learned without the images that are `attacked`.
    pub(super) fn learn(
        &self,
        attacked: &[&KeypointImage],
        k: usize,
    ) -> Result<Option<Predictor>, EvalError> {
        match self {
            Self::Oracle | Self::Transferred => Ok(None),
            Self::Network { model } => Ok(Some(Predictor::Network(Box::new(NeighbourNetwork::open(model)?)))),
            Self::Predicted { train } => {
                let mut images = Vec::new();
                for file in train {
                    let all = read_keypoints(file)?;
                    for image in all.iter().filter(|p| attacked.iter().all(|a| a.name != p.name)) {
                        images.push(known(image)?);
                    }
                }
                Ok(Some(Predictor::Statistic(NeighbourPredictor::fit(&images, k)?)))
            }
        }
    }
}

/// What tells neighbours from descriptors alone.
pub(super) enum Predictor {
    /// Canonical correlations.
    Statistic(NeighbourPredictor),
    /// A trained network.
    Network(Box<NeighbourNetwork>),
}

impl Predictor {
    /// The `k` likeliest neighbours of each keypoint, likeliest first.
    pub(super) fn predict(&self, descriptors: &Descriptors, k: usize) -> Result<NeighbourLists, AttackError> {
        match self {
            Self::Statistic(statistic) => statistic.predict(descriptors, k),
            Self::Network(network) => network.predict(descriptors, k),
        }
    }
}

/// An image with everything that is known of it.
pub(super) fn known(image: &KeypointImage) -> Result<KnownImage, EvalError> {
    let descriptors = descriptors(image)?;
    Ok(KnownImage::new(image.keypoints.clone(), descriptors, image.width, image.height)?)
}

/// What the others of a file, `[images]`, tell about one of them as a server's map would.
pub(super) fn from_others(
    known: &[KnownImage],
    own: usize,
    size: (u32, u32),
    k: usize,
) -> Result<Transfer, AttackError> {
    let map: Vec<KnownImage> =
        known.iter().enumerate().filter(|(i, _)| *i != own).map(|(_, p)| p.clone()).collect();
    transfer(known[own].descriptors(), &map, size, MAP_IMAGES, k)
}

pub(crate) fn descriptors(image: &KeypointImage) -> Result<Descriptors, EvalError> {
    let Some((bytes, dimension)) = &image.descriptors else {
        return Err(EvalError::Options(format!(
            "{} comes without descriptors, and this attack reads them",
            image.name
        )));
    };
    Ok(Descriptors::new(bytes, *dimension)?)
}

/// Shares of right neighbours, weighted by entries.
#[derive(Debug, Default)]
pub(super) struct Precision {
    right: f64,
    random: f64,
    entries: f64,
}

impl Precision {
    pub(super) fn add(&mut self, said: &NeighbourLists, true_lists: &NeighbourLists) {
        let entries: usize = (0..said.len()).map(|i| said.of(i).len()).sum();
        if entries == 0 {
            return;
        }
        let true_entries: usize = (0..true_lists.len()).map(|i| true_lists.of(i).len()).sum();
        let n = true_lists.len() as f64;
        self.entries += entries as f64;
        self.right += said.precision(true_lists) * entries as f64;
        self.random += true_entries as f64 / n / (n - 1.0).max(1.0) * entries as f64;
    }

    /// Precision, and what drawing at random would have; `None` without entries.
    pub(super) fn shares(&self) -> Option<(f64, f64)> {
        (self.entries > 0.0).then(|| (self.right / self.entries, self.random / self.entries))
    }
}
