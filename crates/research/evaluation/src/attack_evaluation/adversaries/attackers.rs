//! Runs the attacks of an adversary on all schemes and selects the best one.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::EvalError;
use crate::attack_evaluation::{
    Attack, AttackDocument, AttackEvaluation, AttackObserver, AttackProgress, AttackSummary, ImageGroup,
    MeasuredKeypoints, NeighbourSource, PrivateRegion, ServerKnowledge, attack_groups,
};
use serde::Serialize;
use veiloc_datasets::problem_files::{KeypointImage, read_keypoints};
use veiloc_features::Progress;
use veiloc_protocol::Scheme;

use super::adversary::Adversary;
use super::keypoints::AttackedKeypoints;

/// Numbers of frames, or of seals of one image, for adversaries with several: limited by the available number.
const FRAMES: [usize; 2] = [2, 8];
const SEALS: usize = 8;
/// Share of the keypoints on a person.
const PRIVATE_SHARE: f64 = 0.1;

/// The attacked keypoints and the resources of adversaries.
pub(crate) struct Attackers<'a> {
    /// The attacked keypoints and the knowledge about their scene.
    pub(crate) keypoints: &'a AttackedKeypoints,
    /// Schemes under which they are sent.
    pub(crate) schemes: &'a [Scheme],
    /// Keypoint files of other scenes, the training data of outsiders; without them outsiders are skipped.
    pub(crate) train: &'a [PathBuf],
    /// A network that predicts neighbours.
    pub(crate) network: Option<&'a Path>,
    /// Position networks, one per scheme.
    pub(crate) positions: &'a [PathBuf],
    /// Whether to run [`Adversary::thorough`] too.
    pub(crate) slow_attacks: bool,
    /// Neighbours per keypoint.
    pub(crate) k: usize,
    /// Seed of all draws.
    pub(crate) seed: u64,
}

/// The gain of an adversary from queries of one scheme.
#[derive(Debug, Clone)]
pub(crate) struct Gain {
    /// Its best attack, by gain over the prior-only baseline.
    pub(crate) best: AttackSummary,
    /// The prior-only baseline on the same keypoints.
    pub(crate) prior: AttackSummary,
    /// All its attacks, in the order they ran.
    pub(crate) tried: Vec<AttackGain>,
    /// Precision of its predicted neighbours; `None` for an oracle, and if no neighbours are used.
    pub(crate) precision: Option<f64>,
    /// Share of all keypoints on which errors are measured.
    pub(crate) measured: f64,
    /// [`AttackSummary::hiding_auc`] of the attack that estimates it.
    pub(crate) hiding_auc: Option<f64>,
}

/// One attack of an adversary with its gain.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AttackGain {
    /// Name of the attack.
    pub attack: String,
    /// Frames or seals that it used; absent for attacks on one query.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<usize>,
    /// Median error, pixels.
    pub median_px: f64,
    /// Gain over the prior-only baseline, bits per keypoint.
    pub bits_over_prior: f64,
}

impl AttackGain {
    fn of(summary: &AttackSummary) -> Self {
        Self {
            attack: summary.attack.to_string(),
            frames: summary.frames,
            median_px: summary.median_px,
            bits_over_prior: summary.bits_over_prior,
        }
    }
}

impl Attackers<'_> {
    /// Gain of an adversary by scheme; empty if its resources are missing, or if a server finds no pose under the
    /// scheme.
    pub(crate) fn gains(
        &self,
        adversary: Adversary,
        progress: &dyn Progress,
    ) -> Result<BTreeMap<String, Gain>, EvalError> {
        let mut attack = self.evaluation();
        let extra = if self.slow_attacks { adversary.slow_attacks() } else { &[] };
        attack.attacks =
            adversary.attacks().iter().chain(extra).filter_map(|name| name.parse::<Attack>().ok()).collect();
        let Some(images) = self.set_resources(adversary, &mut attack)? else { return Ok(BTreeMap::new()) };
        // A server without a pose under a scheme has no gain there; the other schemes are attacked without it.
        let found = loop {
            match run(&attack, images.clone(), adversary.name(), progress) {
                Err(EvalError::NoPose { scheme, .. }) => {
                    attack.schemes.retain(|s| s.to_string() != scheme);
                    if attack.schemes.is_empty() {
                        return Ok(BTreeMap::new());
                    }
                }
                found => break found?,
            }
        };
        Ok(attack.schemes.iter().filter_map(|s| gain(&found, &s.to_string())).collect())
    }

    fn evaluation(&self) -> AttackEvaluation {
        AttackEvaluation {
            schemes: self.schemes.to_vec(),
            k: self.k,
            seed: self.seed,
            attacks: Vec::new(),
            ..AttackEvaluation::default()
        }
    }

    /// Sets the resources of an adversary, and returns its images, the attacked ones first; `None` if resources are
    /// missing.
    fn set_resources(
        &self,
        adversary: Adversary,
        attack: &mut AttackEvaluation,
    ) -> Result<Option<Vec<KeypointImage>>, EvalError> {
        let keypoints = self.keypoints;
        let mut images = keypoints.attacked.clone();
        attack.images = Some(images.len());
        let scene = keypoints.scene.as_ref();
        if adversary.needs_map() && scene.is_none() {
            return Ok(None);
        }
        // What the map shows is known under every scheme; errors are measured on the rest.
        let knowing = || {
            scene.map(|scene| ServerKnowledge {
                problems: vec![scene.problems.clone()],
                map_problems: vec![scene.map_problems.clone()],
                private: (adversary == Adversary::PoseServerPrivate)
                    .then_some(PrivateRegion::Share(PRIVATE_SHARE)),
                turned: 0.0,
                measured: MeasuredKeypoints::Hidden,
            })
        };
        let map = || scene.map_or(&[][..], |scene| &scene.map).iter().cloned();
        match adversary {
            Adversary::OutsiderStatistic if !self.train.is_empty() => {
                attack.neighbours = NeighbourSource::Predicted { train: self.train.to_vec() };
                images.extend(self.other_scenes()?);
            }
            Adversary::OutsiderNeighbours => {
                let Some(model) = self.network else { return Ok(None) };
                attack.neighbours = NeighbourSource::Network { model: model.to_owned() };
                images.extend(self.other_scenes()?);
            }
            Adversary::OutsiderNetwork if !self.positions.is_empty() => {
                attack.positions = self.positions.to_vec();
            }
            Adversary::OutsiderStatistic | Adversary::OutsiderNetwork => return Ok(None),
            Adversary::TrueNeighbours => {}
            Adversary::MapServer => {
                attack.neighbours = NeighbourSource::Transferred;
                images.extend(map());
            }
            Adversary::PoseServer | Adversary::PoseServerPrivate => {
                // The server's own map trains the predictor of neighbours.
                attack.neighbours =
                    NeighbourSource::Predicted { train: scene.iter().map(|p| p.map_file.clone()).collect() };
                attack.server = knowing();
            }
            Adversary::PoseServerImages => {
                attack.server = knowing();
                images.extend(map());
            }
            Adversary::SeveralFrames => {
                attack.server = knowing();
                images.extend(keypoints.others.iter().cloned());
                attack.frames = FRAMES.into_iter().filter(|n| *n <= images.len()).collect();
                if attack.frames.is_empty() {
                    return Ok(None);
                }
            }
            Adversary::SeveralSeals => attack.frames = vec![SEALS],
        }
        Ok(Some(images))
    }

    /// Keypoints of other scenes, for the density of keypoints; their descriptors are not read again.
    fn other_scenes(&self) -> Result<Vec<KeypointImage>, EvalError> {
        let mut images = Vec::new();
        for file in self.train {
            let read = read_keypoints(file).map_err(EvalError::from)?;
            let unknown = |p: &KeypointImage| self.keypoints.attacked.iter().all(|own| own.name != p.name);
            images.extend(
                read.into_iter().filter(unknown).map(|image| KeypointImage { descriptors: None, ..image }),
            );
        }
        Ok(images)
    }
}

/// The best attack on a scheme, with its name.
fn gain(found: &AttackDocument, scheme: &str) -> Option<(String, Gain)> {
    let of_scheme = || found.attacks.iter().filter(|a| a.scheme == scheme);
    let tried = || of_scheme().filter(|a| a.attack != Attack::PRIOR);
    let best = tried().max_by(|a, b| a.bits_over_prior.total_cmp(&b.bits_over_prior))?;
    let prior = of_scheme().find(|a| a.attack == Attack::PRIOR)?;
    let gain = Gain {
        best: best.clone(),
        prior: prior.clone(),
        tried: tried().map(AttackGain::of).collect(),
        precision: found.precision,
        hiding_auc: of_scheme().find_map(|a| a.hiding_auc),
        measured: found.server.iter().find(|s| s.scheme == scheme).map_or(1.0, |s| s.measured),
    };
    Some((scheme.to_owned(), gain))
}

fn run(
    attack: &AttackEvaluation,
    images: Vec<KeypointImage>,
    stage: &str,
    progress: &dyn Progress,
) -> Result<AttackDocument, EvalError> {
    let group = ImageGroup { name: "queries".to_owned(), images };
    attack_groups(attack, vec![group], &mut ProgressObserver(AttackProgress::new(progress, stage)))
}

/// Reports progress.
struct ProgressObserver<'a>(AttackProgress<'a>);

impl AttackObserver for ProgressObserver<'_> {
    fn advance(&mut self, _done: usize, total: usize) {
        self.0.advance(total);
    }
}
