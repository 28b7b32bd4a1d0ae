//! Options: what is attacked, and the attacker's knowledge.

use std::path::PathBuf;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::{KeypointImage, seed_for};
use veiloc_obfuscation::{KnownPlace, PackUse};
use veiloc_protocol::{AngleBits, Scheme};

use super::attacks::{Attack, Knowledge};
use super::multi_view::FrameChoice;
use super::neighbours::NeighbourSource;

/// Options of an evaluation of attacks.
#[derive(Debug, Clone)]
pub struct AttackEvaluation {
    /// Images of one or more scenes.
    pub groups: Vec<ImageGroup>,
    /// Keypoint files, each a further group.
    pub files: Vec<PathBuf>,
    /// Number of uniform keypoints of an additional synthetic image, 0 for none.
    pub synthetic: usize,
    /// Number of images of each group that are attacked, from the first; all of them train the learned prior.
    pub images: Option<usize>,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// Attacks, in the order of the table. The prior-only baseline is always added as the first.
    pub attacks: Vec<Attack>,
    /// The pack of the place that devices have, and what they send with it; `None`: all keypoints with their descriptors.
    pub place: Option<(KnownPlace, PackUse)>,
    /// Source of the neighbour lists.
    pub neighbours: NeighbourSource,
    /// Descriptions of position networks, at most one per scheme. The attack `trained-positions` is skipped for
    /// schemes without a network.
    pub positions: Vec<PathBuf>,
    /// Neighbours per keypoint.
    pub k: usize,
    /// Percent of the neighbours that are replaced by random keypoints; attacks that use neighbours run once for each
    /// value.
    pub corrupt: Vec<f64>,
    /// What a server knows after localizing the images; `None` for an attacker with the sent queries only.
    pub server: Option<ServerKnowledge>,
    /// Numbers of frames of a file for attacks on several frames, including the attacked one; the attacks run once
    /// for each value.
    pub frames: Vec<usize>,
    /// How these frames are chosen.
    pub choice: FrameChoice,
    /// Detector noise from frame to frame of a stationary camera, standard deviation along each axis, pixels; 0 for
    /// seals of one image.
    pub static_noise_px: f64,
    /// Bits of a line's angle, as a device sends it.
    pub angle_bits: AngleBits,
    /// Seed of obfuscation, corruption and starts.
    pub seed: u64,
}

impl AttackEvaluation {
    /// The first attack that needs this.
    pub(super) fn needs(&self, what: Knowledge) -> Option<&Attack> {
        self.attacks.iter().find(|attack| attack.needs(what))
    }

    /// A generator for one use of an image under a scheme.
    pub(super) fn rng(&self, image: &str, scheme: Scheme, what: &str) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(seed_for(self.seed, &[image, &scheme.to_string(), what]))
    }
}

/// Images of one group: for each image, the others train the learned prior and are the map of `transfer`.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageGroup {
    /// Name in the document.
    pub name: String,
    /// The images.
    pub images: Vec<KeypointImage>,
}

/// The paper's attack as in the paper: every scheme, twenty true neighbours per keypoint. The images must still be
/// set.
impl Default for AttackEvaluation {
    fn default() -> Self {
        Self {
            groups: Vec::new(),
            files: Vec::new(),
            synthetic: 0,
            images: None,
            schemes: Scheme::ALL.to_vec(),
            attacks: vec![Attack::CLOSED_FORM],
            place: None,
            neighbours: NeighbourSource::Oracle,
            positions: Vec::new(),
            k: 20,
            corrupt: vec![0.0],
            server: None,
            frames: Vec::new(),
            choice: FrameChoice::default(),
            static_noise_px: 0.0,
            angle_bits: AngleBits::default(),
            seed: 0,
        }
    }
}

/// Keypoints on which errors are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MeasuredKeypoints {
    /// Keypoints whose positions the server does not know from its map.
    #[default]
    Hidden,
    /// All keypoints; for known ones the server's position is the answer.
    All,
    /// Keypoints that the map knows, with their positions withheld from the attack: measures what the lines reveal.
    Matched,
}

/// A region of each image that its map does not show.
#[derive(Debug, Clone, PartialEq)]
pub enum PrivateRegion {
    /// An upright ellipse about a random keypoint that holds this share of the keypoints, 0 to 1.
    Share(f64),
    /// Folder of masks, one per attacked image ([`veiloc_mapping::mask_file`]): what is black is private.
    Masks(PathBuf),
}

/// The server's knowledge.
#[derive(Debug, Clone, PartialEq)]
pub struct ServerKnowledge {
    /// Matches with the map, one problem for each attacked image by its name.
    pub problems: Vec<PathBuf>,
    /// Matches of the map's own images, from which a server knows what should be seen from where; empty to take those
    /// of the other attacked images.
    pub map_problems: Vec<PathBuf>,
    /// A region that is missing from the map, such as a person; errors are then measured on its keypoints.
    pub private: Option<PrivateRegion>,
    /// Share of the image, 0 to 1, in random regions whose descriptors the device sends rotated, so that they match
    /// nothing; errors are not measured there.
    pub rotated: f64,
    /// Where errors are measured, without a private region.
    pub measured: MeasuredKeypoints,
}
