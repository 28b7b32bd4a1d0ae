//! Recovered keypoint positions from the attacks.

use std::collections::BTreeMap;

use veiloc_attacks::Observation;
use veiloc_datasets::problem_files::KeypointImage;
use veiloc_features::Progress;
use veiloc_geometry::Pixel;

use super::super::strongest::strongest;
use super::super::{
    Attack, AttackDocument, AttackEvaluation, AttackTrial, ImageGroup, NeighbourSource, evaluate_attacks,
};
use super::column::{Column, Input};
use super::run::InversionEvaluation;
use crate::EvalError;

/// Attacks that use the statistic, the network and the map.
const WITH_STATISTIC: [&str; 2] = ["learned-prior", "closed-form-consensus"];
const WITH_NETWORK: [&str; 1] = ["trained-positions"];
const WITH_MAP: [&str; 1] = ["transfer"];
/// Attacks of a server that knows the pose, with true neighbours where they use some.
const OF_SERVER: [&str; 3] = ["server-side", "iterative", "occlusion"];

/// What a server knows without any attack: the keypoints that match its map.
const KNOWN: &str = "matched";

/// Results for one image, `[N]` each.
#[derive(Debug, Clone, Default)]
pub(super) struct RecoveredImage {
    /// Recovered keypoints.
    pub(super) positions: Vec<Pixel>,
    /// The sent observations.
    pub(super) sent: Vec<Observation>,
    /// Their errors, pixels.
    pub(super) errors: Vec<f64>,
    /// Whether the error of a keypoint counts: of a server's attacks only the keypoints that it does not know.
    pub(super) measured: Vec<bool>,
}

impl RecoveredImage {
    /// The true keypoints.
    pub(super) fn exact(image: &KeypointImage) -> Self {
        let errors = vec![0.0; image.keypoints.len()];
        let measured = vec![true; errors.len()];
        Self { positions: image.keypoints.clone(), sent: Vec::new(), errors, measured }
    }
}

impl RecoveredImage {
    /// The errors that count.
    pub(super) fn measured(&self) -> impl Iterator<Item = f64> {
        self.errors.iter().zip(&self.measured).filter(|(_, measured)| **measured).map(|(error, _)| *error)
    }
}

/// The attacks of one attacker: their gains, and their answers by scheme and attack.
struct Attacked {
    document: AttackDocument,
    answers: BTreeMap<(String, &'static str), Vec<RecoveredImage>>,
}

impl Attacked {
    fn run(stage: &str, evaluation: AttackEvaluation, progress: &dyn Progress) -> Result<Self, EvalError> {
        let mut answers: BTreeMap<_, Vec<RecoveredImage>> = BTreeMap::new();
        let mut record = |trial: &AttackTrial<'_>| {
            let key = (trial.context.scheme().to_string(), trial.attack.name);
            answers.entry(key).or_default().push(RecoveredImage {
                positions: trial.answers.to_vec(),
                sent: trial.context.observations().to_vec(),
                errors: trial.errors.to_vec(),
                measured: trial.context.sent.measured.clone(),
            });
        };
        let document = evaluate_attacks(&evaluation, stage, progress, &mut record)?;
        Ok(Self { document, answers })
    }

    /// The answers of an attack on each image; `None` if it does not apply to the scheme.
    fn recovered(&self, scheme: &str, attack: &'static str) -> Option<Vec<RecoveredImage>> {
        self.answers.get(&(scheme.to_owned(), attack)).cloned()
    }
}

/// The inputs of the network, in the order of the table. Of a scheme that hides positions: the prior-only baseline, the
/// attacks with true neighbours, the best realistic attack, those of a server, the lines.
pub(super) fn columns(
    inversion: &InversionEvaluation<'_>,
    images: &[KeypointImage],
    progress: &dyn Progress,
) -> Result<Vec<Column>, EvalError> {
    let group = |map: &[KeypointImage]| {
        vec![ImageGroup { name: "images".to_owned(), images: [images, map].concat() }]
    };
    let with_oracle = AttackEvaluation {
        groups: group(&[]),
        images: Some(images.len()),
        positions: Vec::new(),
        ..inversion.attack.clone()
    };
    let of = |stage, names: &[&str], evaluation: AttackEvaluation| {
        let attacks = names.iter().filter_map(|name| name.parse().ok()).collect();
        Attacked::run(stage, AttackEvaluation { attacks, ..evaluation }, progress)
    };
    let mut without_oracle = Vec::new();
    if !inversion.train.is_empty() {
        let neighbours = NeighbourSource::Predicted { train: inversion.train.clone() };
        let evaluation = AttackEvaluation { neighbours, ..with_oracle.clone() };
        without_oracle.push(of("Attacking with a statistic", &WITH_STATISTIC, evaluation)?);
    }
    if !inversion.attack.positions.is_empty() {
        let evaluation =
            AttackEvaluation { positions: inversion.attack.positions.clone(), ..with_oracle.clone() };
        without_oracle.push(of("Attacking with a network", &WITH_NETWORK, evaluation)?);
    }
    if !inversion.map.is_empty() {
        let (groups, neighbours) = (group(&inversion.map), NeighbourSource::Transferred);
        let evaluation = AttackEvaluation { groups, neighbours, ..with_oracle.clone() };
        without_oracle.push(of("Attacking with a map", &WITH_MAP, evaluation)?);
    }
    let of_server = inversion.server.as_ref().map(|server| {
        let evaluation = AttackEvaluation { server: Some(server.clone()), ..with_oracle.clone() };
        of("Attacking as a server", &OF_SERVER, evaluation)
    });
    let of_server = of_server.transpose()?;
    let with_oracle = Attacked::run("Attacking with true neighbours", with_oracle, progress)?;
    let others = inversion.attack.attacks.iter().filter(|attack| **attack != Attack::PRIOR);
    let mut columns = Vec::new();
    for scheme in &inversion.attack.schemes {
        let name = scheme.to_string();
        let mut push = |attack, by, images: Option<Vec<RecoveredImage>>, input: fn(_) -> Input| {
            columns.extend(images.map(|images| Column::new(&name, attack, by, input(images))));
        };
        let exact = || images.iter().map(RecoveredImage::exact).collect();
        push("none", None, (!scheme.hides_positions()).then(exact), Input::Positions);
        for attack in [&Attack::PRIOR].into_iter().chain(others.clone()) {
            push(attack.name, None, with_oracle.recovered(&name, attack.name), Input::Positions);
        }
        if let Some((best, images)) = best_attack(&without_oracle, &name) {
            push("realistic", Some(best.to_string()), Some(images), Input::Positions);
        }
        if let Some(attacked) = &of_server {
            push(KNOWN, None, attacked.recovered(&name, Attack::PRIOR.name), Input::Known);
            for attack in OF_SERVER {
                push(attack, None, attacked.recovered(&name, attack), Input::Positions);
            }
        }
        push("lines", None, with_oracle.recovered(&name, Attack::PRIOR.name), Input::Lines);
    }
    columns.push(Column::new("unordered", "none", None, Input::Unordered));
    columns.push(Column::new("none", "none", None, Input::None));
    Ok(columns)
}

/// The best attack on a scheme, with its answers.
fn best_attack(attackers: &[Attacked], scheme: &str) -> Option<(Attack, Vec<RecoveredImage>)> {
    let tried = attackers.iter().flat_map(|one| &one.document.attacks);
    let best = strongest(tried.filter(|row| row.scheme == scheme && row.attack != Attack::PRIOR))?.attack;
    Some((best, attackers.iter().find_map(|one| one.recovered(scheme, best.name))?))
}
