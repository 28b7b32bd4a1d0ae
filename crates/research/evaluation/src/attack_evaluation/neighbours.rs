//! Source of the attacker's neighbour lists: an oracle, a predictor, or a map.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;
use veiloc_attacks::learned::neighbours::NeighbourNetwork;
use veiloc_attacks::{AttackError, DecodedDescriptors, KnownImage, NeighbourLists, NeighbourPredictor};
use veiloc_datasets::problem_files::{KeypointImage, read_keypoints};
use veiloc_descriptor::{DescriptorKind, Descriptors};

use crate::EvalError;

/// Source of the attacker's neighbour lists.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NeighbourSource {
    /// An oracle that knows the positions: the worst case.
    Oracle,
    /// A statistic of the co-occurrence of descriptors, learned from the images of these files. Images with the name
    /// of an attacked image are left out.
    Predicted {
        /// Files of keypoints with descriptors.
        train: Vec<PathBuf>,
    },
    /// A trained network ([`veiloc_attacks::learned::neighbours`]).
    Network {
        /// Its description file.
        model: PathBuf,
    },
    /// The other images of the same file, used like a server's map: keypoints are neighbours if their matches there
    /// are near each other.
    Transferred,
}

/// A [`NeighbourSource`] without its files, for documents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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

impl NeighbourSource {
    /// The kind of source.
    pub const fn kind(&self) -> Neighbours {
        match self {
            Self::Oracle => Neighbours::Oracle,
            Self::Predicted { .. } => Neighbours::Predicted,
            Self::Network { .. } => Neighbours::Network,
            Self::Transferred => Neighbours::Transferred,
        }
    }

    /// The predictor, if the source has one, learned without the `attacked` images.
    pub(super) fn learn(
        &self,
        attacked: &[&KeypointImage],
        k: usize,
    ) -> Result<Option<Predictor>, EvalError> {
        match self {
            Self::Oracle | Self::Transferred => Ok(None),
            Self::Network { model } => {
                let network = NeighbourNetwork::open(model)?;
                check_features(attacked, network.features())?;
                Ok(Some(Box::new(move |descriptors, k| network.predict(descriptors, k))))
            }
            Self::Predicted { train } => {
                let mut images = Vec::new();
                let mut kind = None;
                for file in train {
                    let all = read_keypoints(file)?;
                    // Images of one file have one kind.
                    if let Some(own) = all.iter().find_map(kind_of) {
                        let first = *kind.get_or_insert(own);
                        if own != first {
                            let name = file.display().to_string();
                            return Err(other_features(name, own.name(), first.name()));
                        }
                    }
                    for image in all.iter().filter(|p| attacked.iter().all(|a| a.name != p.name)) {
                        images.push(known(image)?);
                    }
                }
                if let Some(kind) = kind {
                    check_features(attacked, kind.name())?;
                }
                let statistic = NeighbourPredictor::fit(&images, k)?;
                Ok(Some(Box::new(move |descriptors, k| statistic.predict(descriptors, k))))
            }
        }
    }
}

/// Predicts from descriptors alone the given number of neighbours of each keypoint, likeliest first.
pub(super) type Predictor = Box<dyn Fn(&DecodedDescriptors, usize) -> Result<NeighbourLists, AttackError>>;

/// An image with its keypoints and descriptors.
pub(super) fn known(image: &KeypointImage) -> Result<KnownImage, EvalError> {
    let descriptors = descriptors(image)?;
    Ok(KnownImage::new(image.keypoints.clone(), descriptors, image.width, image.height)?)
}

/// The descriptors of an image.
pub(super) fn descriptors(image: &KeypointImage) -> Result<DecodedDescriptors, EvalError> {
    Ok(DecodedDescriptors::of(stored_descriptors(image)?.view()))
}

/// The same as they are stored.
pub(super) fn stored_descriptors(image: &KeypointImage) -> Result<&Descriptors, EvalError> {
    let refusal =
        || EvalError::Options(format!("{} has no descriptors, but this attack needs them", image.name));
    image.descriptors.as_ref().ok_or_else(refusal)
}

/// The kind of an image's descriptors, if it has any.
fn kind_of(image: &KeypointImage) -> Option<DescriptorKind> {
    image.descriptors.as_ref().map(|descriptors| descriptors.kind())
}

/// Refuses images whose descriptors are not of the kind with this name.
pub(super) fn check_features(images: &[&KeypointImage], expected: &str) -> Result<(), EvalError> {
    let other = images.iter().find_map(|image| {
        let kind = kind_of(image).filter(|kind| kind.name() != expected)?;
        Some(other_features(image.name.clone(), kind.name(), expected))
    });
    other.map_or(Ok(()), Err)
}

fn other_features(name: String, found: &str, expected: &str) -> EvalError {
    EvalError::OtherFeatures { name, found: found.to_owned(), expected: expected.to_owned() }
}

/// Precision of neighbour lists, weighted by entries.
#[derive(Debug, Default)]
pub(super) struct Precision {
    right: f64,
    random: f64,
    entries: f64,
}

impl Precision {
    pub(super) fn add(&mut self, predicted: &NeighbourLists, true_lists: &NeighbourLists) {
        let entries: usize = (0..predicted.len()).map(|i| predicted.of(i).len()).sum();
        if entries == 0 {
            return;
        }
        let true_entries: usize = (0..true_lists.len()).map(|i| true_lists.of(i).len()).sum();
        let n = true_lists.len() as f64;
        self.entries += entries as f64;
        self.right += predicted.precision(true_lists) * entries as f64;
        self.random += true_entries as f64 / n / (n - 1.0).max(1.0) * entries as f64;
    }

    /// Precision, and the precision of random neighbours; `None` without entries.
    pub(super) fn shares(&self) -> Option<(f64, f64)> {
        (self.entries > 0.0).then(|| (self.right / self.entries, self.random / self.entries))
    }
}
