//! Recovered keypoint positions from the attacks.

use std::collections::BTreeMap;
use std::path::PathBuf;

use crate::EvalError;
use crate::attack_evaluation::{
    Attack, AttackDocument, AttackEvaluation, AttackObserver, AttackTrial, ImageGroup, NeighbourSource,
    attack_groups,
};
use veiloc_attacks::Observation;
use veiloc_datasets::problem_files::KeypointImage;
use veiloc_features::Progress;
use veiloc_geometry::Pixel;
use veiloc_protocol::Scheme;

/// Resources of attackers without an oracle.
#[derive(Debug, Clone, Default)]
pub struct RealisticAttackOptions {
    /// Keypoint files of other scenes: training data of the statistic of descriptor co-occurrence.
    pub train: Vec<PathBuf>,
    /// Descriptions of position networks, at most one per scheme.
    pub positions: Vec<PathBuf>,
    /// Images of the scene with keypoints, as a server has them in its map.
    pub map: Vec<KeypointImage>,
}

/// Attacks with true neighbours from the oracle; the prior-only baseline is always added.
const WITH_ORACLE: [&str; 2] = ["closed-form", "graph"];
/// Attacks that use the statistic, the network and the map.
const WITH_STATISTIC: [&str; 2] = ["learned-prior", "closed-form-consensus"];
const WITH_NETWORK: [&str; 1] = ["trained-positions"];
const WITH_MAP: [&str; 1] = ["transfer"];

/// Results of an attack on each image under one scheme.
#[derive(Debug, Clone)]
pub(super) struct RecoveredImages {
    pub(super) scheme: Scheme,
    /// `prior`, `closed-form`, `graph` or `realistic`.
    pub(super) attack: &'static str,
    /// Name of the best realistic attack.
    pub(super) by: Option<String>,
    /// By image.
    pub(super) images: Vec<RecoveredImage>,
}

/// Results for one image, `[N]` each.
#[derive(Debug, Clone, Default)]
pub(super) struct RecoveredImage {
    /// Recovered keypoints.
    pub(super) positions: Vec<Pixel>,
    /// The sent observations.
    pub(super) sent: Vec<Observation>,
    /// Their errors, pixels.
    pub(super) errors: Vec<f64>,
}

/// Records every answer and reports progress.
struct AnswerRecorder<'a> {
    answers: BTreeMap<(String, &'static str), Vec<RecoveredImage>>,
    progress: &'a dyn Progress,
}

impl AttackObserver for AnswerRecorder<'_> {
    fn advance(&mut self, _done: usize, _total: usize) {
        self.progress.advance(1);
    }

    fn saw(&mut self, trial: &AttackTrial<'_>) {
        self.answers.entry((trial.scheme.to_string(), trial.attack.name)).or_default().push(RecoveredImage {
            positions: trial.answers.to_vec(),
            sent: trial.observations.to_vec(),
            errors: trial.errors.to_vec(),
        });
    }
}

/// Attacks these images under all schemes that hide positions. By scheme: the prior-only baseline, the attacks with
/// true neighbours, the best realistic attack.
pub(super) fn attack(
    images: &[KeypointImage],
    schemes: &[Scheme],
    realistic: &RealisticAttackOptions,
    (k, seed): (usize, u64),
    progress: &dyn Progress,
) -> Result<Vec<RecoveredImages>, EvalError> {
    let schemes: Vec<Scheme> = schemes.iter().copied().filter(|scheme| scheme.hides_positions()).collect();
    if schemes.is_empty() {
        return Ok(Vec::new());
    }
    let run = |stage: &str, names: &[&str], neighbours, positions: &[PathBuf], map: &[KeypointImage]| {
        let attacks: Vec<Attack> = names.iter().filter_map(|name| name.parse().ok()).collect();
        progress.start(stage, images.len() * schemes.len() * (attacks.len() + 1));
        let evaluation = AttackEvaluation {
            images: Some(images.len()),
            schemes: schemes.clone(),
            attacks,
            neighbours,
            positions: positions.to_vec(),
            k,
            seed,
            ..AttackEvaluation::default()
        };
        let all = images.iter().chain(map).cloned().collect();
        let mut recorder = AnswerRecorder { answers: BTreeMap::new(), progress };
        let groups = vec![ImageGroup { name: "images".to_owned(), images: all }];
        let document = attack_groups(&evaluation, groups, &mut recorder)?;
        progress.finish();
        Ok::<_, EvalError>((document, recorder.answers))
    };

    let mut runs =
        vec![run("Attacking with true neighbours", &WITH_ORACLE, NeighbourSource::Oracle, &[], &[])?];
    if !realistic.train.is_empty() {
        let learned = NeighbourSource::Predicted { train: realistic.train.clone() };
        runs.push(run("Attacking with a statistic", &WITH_STATISTIC, learned, &[], &[])?);
    }
    if !realistic.positions.is_empty() {
        let (oracle, files) = (NeighbourSource::Oracle, &realistic.positions);
        runs.push(run("Attacking with a network", &WITH_NETWORK, oracle, files, &[])?);
    }
    if !realistic.map.is_empty() {
        let map = &realistic.map;
        runs.push(run("Attacking with a map", &WITH_MAP, NeighbourSource::Transferred, &[], map)?);
    }
    let mut attacked = Vec::new();
    for scheme in schemes {
        let name = scheme.to_string();
        let answers = |(_, all): &(AttackDocument, BTreeMap<(String, &'static str), Vec<RecoveredImage>>),
                       attack| {
            all.get(&(name.clone(), attack)).cloned().unwrap_or_default()
        };
        let mut push = |attack, by, images: Vec<RecoveredImage>| {
            if !images.is_empty() {
                attacked.push(RecoveredImages { scheme, attack, by, images });
            }
        };
        push("prior", None, answers(&runs[0], Attack::PRIOR.name));
        for attack in WITH_ORACLE {
            push(attack, None, answers(&runs[0], attack));
        }
        let tried = runs[1..].iter().flat_map(|run| {
            let of_scheme = run.0.attacks.iter().filter(|row| row.scheme == name);
            of_scheme.filter(|row| row.attack != Attack::PRIOR).map(move |row| (row, run))
        });
        let best = tried.max_by(|a, b| a.0.bits_over_prior.total_cmp(&b.0.bits_over_prior));
        if let Some((row, run)) = best {
            push("realistic", Some(row.attack.to_string()), answers(run, row.attack.name));
        }
    }
    Ok(attacked)
}
