//! Runs the attacks of an adversary on all schemes and selects the best one.

use veiloc_datasets::problem_files::{KeypointImage, read_keypoints};
use veiloc_features::Progress;

use super::super::strongest::strongest;
use super::super::{
    Attack, AttackDocument, AttackEvaluation, AttackSummary, ImageGroup, MeasuredKeypoints, NeighbourSource,
    PrivateRegion, ServerKnowledge, evaluate_attacks,
};
use super::adversary::Adversary;
use super::document::{AdversaryRow, AttackGain};
use super::keypoints::AttackedKeypoints;
use super::options::AdversariesEvaluation;
use crate::EvalError;

/// Numbers of frames, or of seals of one image, for adversaries with several: limited by the available number.
const FRAMES: [usize; 2] = [2, 8];
const SEALS: usize = 8;
/// Share of the keypoints on a person.
const PRIVATE_SHARE: f64 = 0.1;

/// Gain of an adversary, one row per scheme; empty if its resources are missing, or if a server finds no pose under any
/// scheme.
pub(super) fn gains(
    evaluation: &AdversariesEvaluation,
    keypoints: &AttackedKeypoints,
    adversary: Adversary,
    progress: &dyn Progress,
) -> Result<Vec<AdversaryRow>, EvalError> {
    let Some(mut attack) = attack_of(evaluation, keypoints, adversary)? else { return Ok(Vec::new()) };
    // A server without a pose under a scheme has no gain there; the other schemes are attacked without it.
    while !attack.schemes.is_empty() {
        match evaluate_attacks(&attack, adversary.name(), progress, &mut |_| {}) {
            Err(EvalError::NoPose { scheme, .. }) => attack.schemes.retain(|s| s.to_string() != scheme),
            found => {
                let found = found?;
                let baselines = found.attacks.iter().filter(|row| row.attack == Attack::PRIOR);
                return Ok(baselines
                    .filter_map(|prior| AdversaryRow::of(&keypoints.data, adversary, &found, prior))
                    .collect());
            }
        }
    }
    Ok(Vec::new())
}

/// The attacks of an adversary with its resources; `None` if some are missing.
fn attack_of(
    evaluation: &AdversariesEvaluation,
    keypoints: &AttackedKeypoints,
    adversary: Adversary,
) -> Result<Option<AttackEvaluation>, EvalError> {
    let scene = keypoints.scene.as_ref();
    if adversary.needs_map() && scene.is_none() {
        return Ok(None);
    }
    let slow = if evaluation.slow_attacks { adversary.slow_attacks() } else { &[] };
    let names = adversary.attacks().iter().chain(slow);
    let mut attack = AttackEvaluation {
        files: Vec::new(),
        images: Some(keypoints.attacked.len()),
        attacks: names.filter_map(|name| name.parse().ok()).collect(),
        positions: Vec::new(),
        ..evaluation.attack.clone()
    };
    // What the map shows is known under every scheme; errors are measured on the rest.
    attack.server = scene.filter(|_| adversary.knows_pose()).map(|scene| ServerKnowledge {
        problems: vec![scene.problems.clone()],
        map_problems: vec![scene.map_problems.clone()],
        private: (adversary == Adversary::PoseServerPrivate).then_some(PrivateRegion::Share(PRIVATE_SHARE)),
        rotated: 0.0,
        measured: MeasuredKeypoints::Hidden,
    });
    let map = || scene.map_or(&[][..], |scene| &scene.map).to_vec();
    let mut others: Vec<KeypointImage> = Vec::new();
    match adversary {
        Adversary::QueryOnlyStatistic => {
            if evaluation.train.is_empty() {
                return Ok(None);
            }
            attack.neighbours = NeighbourSource::Predicted { train: evaluation.train.clone() };
            others = other_scenes(evaluation, keypoints)?;
        }
        Adversary::QueryOnlyNeighbours => {
            let Some(model) = evaluation.network.clone() else { return Ok(None) };
            attack.neighbours = NeighbourSource::Network { model };
            others = other_scenes(evaluation, keypoints)?;
        }
        Adversary::QueryOnlyNetwork => {
            if evaluation.attack.positions.is_empty() {
                return Ok(None);
            }
            attack.positions.clone_from(&evaluation.attack.positions);
        }
        Adversary::TrueNeighbours => {}
        Adversary::MapServer => {
            attack.neighbours = NeighbourSource::Transferred;
            others = map();
        }
        Adversary::PoseServer | Adversary::PoseServerPrivate => {
            // The server's own map trains the predictor of neighbours.
            attack.neighbours =
                NeighbourSource::Predicted { train: scene.iter().map(|p| p.map_file.clone()).collect() };
        }
        Adversary::PoseServerImages => others = map(),
        Adversary::SeveralFrames => {
            others.clone_from(&keypoints.others);
            let most = keypoints.attacked.len() + others.len();
            attack.frames = FRAMES.into_iter().filter(|n| *n <= most).collect();
            if attack.frames.is_empty() {
                return Ok(None);
            }
        }
        Adversary::SeveralSeals => attack.frames = vec![SEALS],
    }
    let images = [keypoints.attacked.as_slice(), &others].concat();
    attack.groups = vec![ImageGroup { name: "queries".to_owned(), images }];
    Ok(Some(attack))
}

/// Keypoints of other scenes, for the density of keypoints; their descriptors are not read again.
fn other_scenes(
    evaluation: &AdversariesEvaluation,
    keypoints: &AttackedKeypoints,
) -> Result<Vec<KeypointImage>, EvalError> {
    let mut images = Vec::new();
    for file in &evaluation.train {
        let mut read = read_keypoints(file)?;
        read.retain(|image| keypoints.attacked.iter().all(|own| own.name != image.name));
        images.extend(read.into_iter().map(|image| KeypointImage { descriptors: None, ..image }));
    }
    Ok(images)
}

impl AdversaryRow {
    /// The best attack on the scheme of this baseline; `None` if no attack applies to it.
    fn of(data: &str, adversary: Adversary, found: &AttackDocument, prior: &AttackSummary) -> Option<Self> {
        let scheme = &prior.scheme;
        let tried = || found.attacks.iter().filter(|a| a.scheme == *scheme && a.attack != Attack::PRIOR);
        let best = strongest(tried())?;
        Some(Self {
            data: data.to_owned(),
            adversary: adversary.name(),
            realistic: adversary.is_realistic(),
            scheme: scheme.clone(),
            attack: best.attack.to_string(),
            frames: best.frames,
            images: best.images,
            measured: found.server.iter().find(|s| s.scheme == *scheme).map_or(1.0, |s| s.measured),
            precision: found.precision,
            prior_median_px: prior.median_px,
            median_px: best.median_px,
            under_10px: best.under_10px,
            under_30px: best.under_30px,
            bits_over_prior: best.bits_over_prior,
            hiding_auc: tried().find_map(|a| a.hiding_auc),
            attacks: tried()
                .map(|a| AttackGain {
                    attack: a.attack.to_string(),
                    frames: a.frames,
                    median_px: a.median_px,
                    bits_over_prior: a.bits_over_prior,
                })
                .collect(),
        })
    }
}
