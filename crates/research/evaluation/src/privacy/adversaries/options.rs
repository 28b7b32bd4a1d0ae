//! Who is attacked by whom, and what outsiders have learned from.

use std::path::PathBuf;

use veiloc_localization::LocalizeOptions;
use veiloc_map::PosedImages;
use veiloc_mapping::BuildOptions;
use veiloc_protocol::Scheme;

use super::adversary::Adversary;

use crate::EvalError;

/// A place with known poses, split into map and queries.
#[derive(Debug, Clone)]
pub struct Place {
    /// Cameras and poses.
    pub posed: PosedImages,
    /// Folder of the images.
    pub images: PathBuf,
    /// Images the map is built from.
    pub map_list: Vec<String>,
    /// Images that are queries.
    pub query_list: Vec<String>,
    /// How the map is built.
    pub build: BuildOptions,
    /// Retrieval and matching.
    pub localize: LocalizeOptions,
    /// Folder of the queries' masks ([`veiloc_features::mask_in`]): what they hide is not sent. Nothing is hidden when none.
    pub masks: Option<PathBuf>,
}

/// What is attacked, and with what.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct AdversariesEvaluation {
    /// A place, whose map servers know; `None` for files alone.
    pub place: Option<Place>,
    /// Files of keypoints of images of which nobody has a map.
    pub files: Vec<PathBuf>,
    /// Schemes, in the order of the table. One that hides no position has nothing to attack.
    pub schemes: Vec<Scheme>,
    /// Who attacks, in the order of the table.
    pub adversaries: Vec<Adversary>,
    /// Files of keypoints of elsewhere, which outsiders learn from; without any there is no outsider.
    pub train: Vec<PathBuf>,
    /// A network that predicts neighbours, trained elsewhere.
    pub network: Option<PathBuf>,
    /// Networks from all rows to positions, trained elsewhere, one a scheme; as above.
    pub positions: Vec<PathBuf>,
    /// How many images of a place or file are attacked, spread evenly; `None` for all.
    pub attacked: Option<usize>,
    /// Whether attacks are tried that take seconds an image.
    pub thorough: bool,
    /// Neighbours a keypoint.
    pub k: usize,
    /// Seed of every draw.
    pub seed: u64,
}

impl AdversariesEvaluation {
    /// All schemes that hide positions, all images; what is attacked is still to be said.
    pub fn new() -> Self {
        Self {
            place: None,
            files: Vec::new(),
            schemes: Scheme::ALL.into_iter().filter(|s| s.hides_positions()).collect(),
            adversaries: Adversary::ALL.to_vec(),
            train: Vec::new(),
            network: None,
            positions: Vec::new(),
            attacked: None,
            thorough: true,
            k: 20,
            seed: 0,
        }
    }

    pub(super) fn check(&self) -> Result<(), EvalError> {
        let refuse = |why: &str| Err(EvalError::Options(why.to_owned()));
        if self.place.as_ref().is_none_or(|place| place.query_list.is_empty()) && self.files.is_empty() {
            return refuse("nothing to attack: give a place with queries, or files of keypoints");
        }
        if !self.schemes.iter().any(|s| s.hides_positions()) {
            return refuse("no scheme to attack: points are sent as they are");
        }
        if self.adversaries.is_empty() {
            return refuse("no adversary to attack with");
        }
        if self.k == 0 || self.attacked == Some(0) {
            return refuse("no image or neighbour to attack");
        }
        Ok(())
    }
}

impl Default for AdversariesEvaluation {
    fn default() -> Self {
        Self::new()
    }
}
