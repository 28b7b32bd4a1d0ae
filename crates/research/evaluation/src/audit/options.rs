//! What is attacked, and what the attacker knows.

use std::path::PathBuf;

use veiloc_protocol::{AngleBits, Scheme};

use crate::audit::attacks::Attack;
use crate::audit::neighbours::NeighbourSource;
use crate::audit::sightings::FrameChoice;

/// What to attack, and how.
#[derive(Debug, Clone)]
pub struct AttackEvaluation {
    /// Files of keypoints; empty for [`Self::synthetic`] alone.
    pub files: Vec<PathBuf>,
    /// Evenly spread keypoints of an additional image, 0 for none.
    pub synthetic: usize,
    /// Images of each file that are attacked, from the first; all of them teach the learned prior.
    pub images: Option<usize>,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// Attacks, in the order of the table. The guess is always there, first.
    pub attacks: Vec<Attack>,
    /// Who tells the neighbours.
    pub neighbours: NeighbourSource,
    /// Descriptions of networks of positions, one a scheme at most. Where a scheme has none, the attack
    /// `trained-positions` is left out.
    pub positions: Vec<PathBuf>,
    /// Neighbours a keypoint.
    pub k: usize,
    /// Percent of the neighbours that are replaced by keypoints drawn at random; the neighbour attacks run once each.
    pub corrupt: Vec<f64>,
    /// What a server knows that has localized the images; `None` for an attacker who has only what was sent.
    pub server: Option<ServerKnowledge>,
    /// How many frames of a file an attack that needs several puts together, the attacked one included; once each.
    pub frames: Vec<usize>,
    /// Which frames of the file those are.
    pub choice: FrameChoice,
    /// How much a detector errs from frame to frame of a camera at rest, standard deviation along each axis, pixels; 0
    /// for seals of one image.
    pub resting_noise_px: f64,
    /// Bits of a line's angle, as a device sends them.
    pub angle_bits: AngleBits,
    /// Seed of obfuscation, corruption and starts.
    pub seed: u64,
}

/// The paper's attack as the paper runs it: every scheme, twenty true neighbours a keypoint. What is attacked is still to
/// be said.
impl Default for AttackEvaluation {
    fn default() -> Self {
        Self {
            files: Vec::new(),
            synthetic: 0,
            images: None,
            schemes: Scheme::ALL.to_vec(),
            attacks: vec![Attack::CLOSED_FORM],
            neighbours: NeighbourSource::Oracle,
            positions: Vec::new(),
            k: 20,
            corrupt: vec![0.0],
            server: None,
            frames: Vec::new(),
            choice: FrameChoice::default(),
            resting_noise_px: 0.0,
            angle_bits: AngleBits::default(),
            seed: 0,
        }
    }
}

/// On which keypoints errors are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Measured {
    /// Those whose position the server does not know from its map.
    #[default]
    Hidden,
    /// All, the known ones with the positions the server has for them.
    All,
    /// Those whose position the server knows from its map, and is not told: what lines tell of them.
    Matched,
}

/// What the server brings.
#[derive(Debug, Clone, PartialEq)]
pub struct ServerKnowledge {
    /// Matches with the map, one problem for each attacked image by its name.
    pub problems: Vec<PathBuf>,
    /// Share of the keypoints, 0 to 1, in a compact region that the map does not have, as a person in the image;
    /// errors are then measured on that region.
    pub private: Option<f64>,
    /// Where errors are measured, unless in a private region.
    pub measured: Measured,
}
