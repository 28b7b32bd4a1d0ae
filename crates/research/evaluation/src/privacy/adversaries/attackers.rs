//! Runs what an adversary tries on all schemes, and keeps the best.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::EvalError;
use crate::audit::{
    Attack, AttackDocument, AttackEvaluation, AttackObserver, AttackSummary, ImageGroup, Measured,
    NeighbourSource, ServerKnowledge, Stage, attack_groups,
};
use serde::Serialize;
use veiloc_datasets::problem_files::{KeypointImage, read_keypoints};
use veiloc_features::Progress;
use veiloc_protocol::Scheme;

use super::adversary::Adversary;
use super::keypoints::Keypoints;

/// Frames that an adversary of several puts together, and seals of one image: as many as there are at most.
const FRAMES: [usize; 2] = [2, 8];
const SEALS: usize = 8;

/// What is attacked, and what adversaries may use.
pub(crate) struct Attackers<'a> {
    /// What is attacked, and what is known of its place.
    pub(crate) keypoints: &'a Keypoints,
    /// Schemes it is sent under.
    pub(crate) schemes: &'a [Scheme],
    /// Files of keypoints of elsewhere, which outsiders learn from; one who has none is no outsider and is left out.
    pub(crate) train: &'a [PathBuf],
    /// A network that predicts neighbours.
    pub(crate) network: Option<&'a Path>,
    /// Networks of positions, one a scheme.
    pub(crate) positions: &'a [PathBuf],
    /// Whether to try [`Adversary::thorough`] too.
    pub(crate) thorough: bool,
    /// Neighbours a keypoint.
    pub(crate) k: usize,
    /// Seed of all draws.
    pub(crate) seed: u64,
}

/// What an adversary gains from queries of one scheme.
#[derive(Debug, Clone)]
pub(crate) struct Gain {
    /// The best of their attacks, by bits over the guess.
    pub(crate) best: AttackSummary,
    /// The guess on the same keypoints.
    pub(crate) guess: AttackSummary,
    /// Every attack they tried, in the order they did.
    pub(crate) tried: Vec<Tried>,
    /// Share of the neighbours they were told that are true; `None` for an oracle and where none are used.
    pub(crate) precision: Option<f64>,
    /// Share of all keypoints that errors are of.
    pub(crate) measured: f64,
}

/// An attack that was tried, by what it tells.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tried {
    /// Its name.
    pub attack: String,
    /// Frames or seals that it had; absent for attacks on one query.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<usize>,
    /// Median error, pixels.
    pub median_px: f64,
    /// What it tells beyond the guess, bits a keypoint.
    pub bits_over_prior: f64,
}

impl Tried {
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
    /// Mean error of the guess on all images, attacked or not, by scheme, pixels.
    pub(crate) fn guess(&self, progress: &dyn Progress) -> Result<BTreeMap<String, f64>, EvalError> {
        let images: Vec<KeypointImage> = self.keypoints.all().cloned().collect();
        let guessed = run(&self.evaluation(), images, "Guessing", progress)?;
        Ok(guessed.attacks.into_iter().map(|a| (a.scheme, a.mean_px)).collect())
    }

    /// What an adversary gains, by scheme; nothing for one who lacks what it takes, nor under a scheme that gives a
    /// server no pose.
    pub(crate) fn gains(
        &self,
        adversary: Adversary,
        progress: &dyn Progress,
    ) -> Result<BTreeMap<String, Gain>, EvalError> {
        let mut attack = self.evaluation();
        let extra = if self.thorough { adversary.thorough() } else { &[] };
        attack.attacks =
            adversary.attacks().iter().chain(extra).filter_map(|name| name.parse::<Attack>().ok()).collect();
        let Some(images) = self.give(adversary, &mut attack)? else { return Ok(BTreeMap::new()) };
        // A server that finds no pose under a scheme knows nothing there; the others are attacked without it.
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

    /// Gives an adversary what they know, and says which images they have, the attacked first; `None` when they lack
    /// what it takes.
    fn give(
        &self,
        adversary: Adversary,
        attack: &mut AttackEvaluation,
    ) -> Result<Option<Vec<KeypointImage>>, EvalError> {
        let keypoints = self.keypoints;
        let mut images = keypoints.attacked.clone();
        attack.images = Some(images.len());
        let place = keypoints.place.as_ref();
        if adversary.needs_place() && place.is_none() {
            return Ok(None);
        }
        // What the map shows is known under every scheme: what counts is the rest.
        let knowing = || {
            place.map(|place| ServerKnowledge {
                problems: vec![place.problems.clone()],
                private: None,
                measured: Measured::Hidden,
            })
        };
        let map = || place.map_or(&[][..], |place| &place.map).iter().cloned();
        match adversary {
            Adversary::OutsiderStatistic if !self.train.is_empty() => {
                attack.neighbours = NeighbourSource::Predicted { train: self.train.to_vec() };
                images.extend(self.elsewhere()?);
            }
            Adversary::OutsiderNeighbours => {
                let Some(model) = self.network else { return Ok(None) };
                attack.neighbours = NeighbourSource::Network { model: model.to_owned() };
                images.extend(self.elsewhere()?);
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
            Adversary::PoseServer => {
                // Its own map teaches it what is near what.
                attack.neighbours =
                    NeighbourSource::Predicted { train: place.iter().map(|p| p.map_file.clone()).collect() };
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

    /// Keypoints of elsewhere, which say where keypoints mostly lie; their descriptors are not asked for again.
    fn elsewhere(&self) -> Result<Vec<KeypointImage>, EvalError> {
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

/// The best of the attacks on a scheme, with its name.
fn gain(found: &AttackDocument, scheme: &str) -> Option<(String, Gain)> {
    let of_scheme = || found.attacks.iter().filter(|a| a.scheme == scheme);
    let tried = || of_scheme().filter(|a| a.attack != Attack::PRIOR);
    let best = tried().max_by(|a, b| a.bits_over_prior.total_cmp(&b.bits_over_prior))?;
    let guess = of_scheme().find(|a| a.attack == Attack::PRIOR)?;
    let gain = Gain {
        best: best.clone(),
        guess: guess.clone(),
        tried: tried().map(Tried::of).collect(),
        precision: found.precision,
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
    attack_groups(attack, vec![group], &mut Watched(Stage::new(progress, stage)))
}

/// Tells how far the work is.
struct Watched<'a>(Stage<'a>);

impl AttackObserver for Watched<'_> {
    fn advance(&mut self, _done: usize, total: usize) {
        self.0.advance(total);
    }
}
