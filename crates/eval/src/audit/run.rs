//! Runs every attack on every scheme and picture.

use std::path::{Path, PathBuf};
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{
    AttackError, ClosedFormOptions, Density, ErrorSummary, GraphOptions, KnownPicture, NeighbourLists,
    Observation, PlaceCounts, Transfer, bits_over_prior, closed_form, errors_px, graph, prior_only,
};
use veiloc_geometry::Pixel;
use veiloc_obfuscation::obfuscate_points;
use veiloc_query::{AngleBits, Observations, Scheme};

use super::document::{AttackDocument, AttackSummary};
use super::keypoints::{KeypointPicture, read_keypoints, synthetic_picture};
use super::kind::AttackKind;
use super::neighbours::{NeighbourSource, Precision, descriptors, from_others, known};
use super::observer::{AttackObserver, AttackTrial, PictureGroup, Progress};
use crate::error::EvalError;
use crate::metrics::median;
use crate::seeds::seed_for;

/// What to attack, and how.
#[derive(Debug, Clone)]
pub struct AttackEvaluation {
    /// Files of keypoints; empty for [`Self::synthetic`] alone.
    pub files: Vec<PathBuf>,
    /// Evenly spread keypoints of an additional picture, 0 for none.
    pub synthetic: usize,
    /// Pictures of each file that are attacked, from the first; all of them teach the learned prior.
    pub pictures: Option<usize>,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// Attacks, in the order of the table. The guess is always there, first.
    pub attacks: Vec<AttackKind>,
    /// Who tells the neighbours.
    pub neighbours: NeighbourSource,
    /// Neighbours a keypoint.
    pub k: usize,
    /// Percent of the neighbours that are replaced by keypoints drawn by lot; the neighbour attacks run once each.
    pub corrupt: Vec<f64>,
    /// Bits of a line's angle, as a profile sets them.
    pub angle_bits: AngleBits,
    /// Seed of obfuscation, corruption and starts.
    pub seed: u64,
}

/// One row being filled.
struct Row {
    scheme: Scheme,
    attack: AttackKind,
    corrupt: f64,
    errors: Vec<f64>,
    /// Bits times keypoints, summed over pictures.
    bits: f64,
    ms: Vec<f64>,
}

/// What the attacker holds of one picture beside what was sent.
struct Held {
    density: Density,
    neighbours: NeighbourLists,
    transferred: Option<Transfer>,
}

/// What a picture sends under one scheme, and how far off the guess from it is.
struct Sent {
    scheme: Scheme,
    observed: Observations,
    observations: Vec<Observation>,
    guess_errors: Vec<f64>,
}

/// Pixels within which neighbours agree, in shares of the picture's width: 20 px of 640.
const CONSENSUS: f64 = 20.0 / 640.0;

/// Attacks everything; `advance` is called with the work done and all of it.
///
/// # Errors
/// [`EvalError`] when a file cannot be read, holds nothing, or has a keypoint that no scheme can send.
pub fn evaluate_attacks(
    evaluation: &AttackEvaluation,
    advance: impl FnMut(usize, usize),
) -> Result<AttackDocument, EvalError> {
    attack_groups(evaluation, Vec::new(), &mut Progress(advance))
}

/// Attacks everything, `groups` beside the files of the evaluation, under the eyes of an observer.
///
/// Groups come first in the document's `data`, then the files, then the synthetic picture.
///
/// # Errors
/// As [`evaluate_attacks`].
pub fn attack_groups(
    evaluation: &AttackEvaluation,
    groups: Vec<PictureGroup>,
    observer: &mut dyn AttackObserver,
) -> Result<AttackDocument, EvalError> {
    let (mut data, mut groups): (Vec<String>, Vec<Vec<KeypointPicture>>) =
        groups.into_iter().map(|g| (g.name, g.pictures)).unzip();
    for file in &evaluation.files {
        groups.push(read_keypoints(file)?);
        data.push(display_name(file));
    }
    if evaluation.synthetic > 0 {
        groups.push(vec![synthetic_picture(evaluation.synthetic, evaluation.seed)]);
        data.push(format!("synthetic {}", evaluation.synthetic));
    }

    let mut rows = rows(evaluation);
    let pictures: usize = groups.iter().map(|g| g.len().min(evaluation.pictures.unwrap_or(usize::MAX))).sum();
    let total = pictures * rows.len();
    let mut done = 0;
    let most = evaluation.pictures.unwrap_or(usize::MAX);
    let attacked: Vec<&KeypointPicture> = groups.iter().flat_map(|g| g.iter().take(most)).collect();
    let predictor = evaluation.neighbours.learn(&attacked, evaluation.k)?;
    let transfers = evaluation.neighbours == NeighbourSource::Transferred
        || evaluation.attacks.iter().any(|a| a.transfers());
    let mut precision = Precision::default();
    for (group_index, group) in groups.iter().enumerate() {
        let counts: Vec<PlaceCounts> =
            group.iter().map(|p| PlaceCounts::of(&p.keypoints, p.width, p.height)).collect();
        let mut all = PlaceCounts::default();
        for counts in &counts {
            all.add(counts);
        }
        let map: Vec<KnownPicture> =
            if transfers { group.iter().map(known).collect::<Result<_, _>>()? } else { Vec::new() };
        for (i, (picture, own)) in group.iter().zip(&counts).take(most).enumerate() {
            let mut others = all.clone();
            others.subtract(own);
            let size = (picture.width, picture.height);
            let transferred = if transfers { Some(from_others(&map, i, size, evaluation.k)?) } else { None };
            let nearest = NeighbourLists::nearest(&picture.keypoints, evaluation.k);
            let neighbours = match (&predictor, &transferred) {
                (Some(predictor), _) => predictor.predict(&descriptors(picture)?, evaluation.k)?,
                (None, Some(t)) if evaluation.neighbours == NeighbourSource::Transferred => {
                    t.neighbours.clone()
                }
                _ => nearest.clone(),
            };
            precision.add(&neighbours, &nearest);
            let held = Held { density: others.density(), neighbours, transferred };
            attack_picture(evaluation, (group_index, picture), &held, &mut rows, &mut |trial| {
                observer.saw(trial);
                done += 1;
                observer.advance(done, total);
            })?;
        }
    }
    let oracle = evaluation.neighbours == NeighbourSource::Oracle;
    let told = precision.shares().filter(|_| !oracle);
    Ok(AttackDocument {
        version: 1,
        command: "attack",
        data,
        neighbours: evaluation.neighbours.name(),
        k: evaluation.k,
        precision: told.map(|t| t.0),
        chance: told.map(|t| t.1),
        seed: evaluation.seed,
        attacks: rows.iter().map(|row| summary(row, pictures)).collect(),
    })
}

fn display_name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// Rows of the table, scheme by scheme, the guess first.
fn rows(evaluation: &AttackEvaluation) -> Vec<Row> {
    let mut rows = Vec::new();
    for &scheme in evaluation.schemes.iter().filter(|s| s.hides_positions()) {
        let mut push = |attack, corrupt| {
            rows.push(Row { scheme, attack, corrupt, errors: Vec::new(), bits: 0.0, ms: Vec::new() });
        };
        push(AttackKind::Prior, 0.0);
        for &attack in evaluation.attacks.iter().filter(|a| **a != AttackKind::Prior) {
            if attack.uses_neighbours() {
                evaluation.corrupt.iter().for_each(|corrupt| push(attack, *corrupt));
            } else {
                push(attack, 0.0);
            }
        }
    }
    rows
}

fn attack_picture(
    evaluation: &AttackEvaluation,
    (group, picture): (usize, &KeypointPicture),
    held: &Held,
    rows: &mut [Row],
    attacked: &mut dyn FnMut(&AttackTrial<'_>),
) -> Result<(), EvalError> {
    let truth = &picture.keypoints;
    let mut sent: Option<Sent> = None;
    for row in rows {
        let name = row.scheme.to_string();
        // The seed names picture and scheme: no choice of other schemes or attacks changes what is sent.
        let rng =
            |what: &str| ChaCha8Rng::seed_from_u64(seed_for(evaluation.seed, &[&picture.name, &name, what]));
        if sent.as_ref().is_none_or(|s| s.scheme != row.scheme) {
            let observed = obfuscate_points(
                truth,
                picture.width,
                picture.height,
                &row.scheme,
                evaluation.angle_bits,
                &mut rng("sent"),
            )
            .map_err(|source| EvalError::Seal { name: picture.name.clone(), source })?;
            let observations = Observation::of_sent(&observed);
            sent = Some(Sent { scheme: row.scheme, observed, observations, guess_errors: Vec::new() });
        }
        let Some(sent) = &mut sent else { continue };
        let corrupted = held.neighbours.corrupted(row.corrupt / 100.0, &mut rng("corrupted"));
        let started = Instant::now();
        let answers = answer(row.attack, &sent.observations, &corrupted, picture, held, &mut rng("attack"))?;
        row.ms.push(started.elapsed().as_secs_f64() * 1e3);
        let errors = errors_px(answers.iter().copied(), truth);
        if row.attack == AttackKind::Prior {
            sent.guess_errors.clone_from(&errors);
        }
        if !errors.is_empty() {
            let bits = bits_over_prior(&errors, &sent.guess_errors, picture.width, picture.height);
            row.bits += bits * errors.len() as f64;
        }
        attacked(&AttackTrial {
            group,
            picture,
            scheme: row.scheme,
            attack: row.attack,
            corrupt: row.corrupt,
            sent: &sent.observed,
            observations: &sent.observations,
            neighbours: &corrupted,
            answers: &answers,
            errors: &errors,
        });
        row.errors.extend(errors);
    }
    Ok(())
}

/// One attack on one picture: `[N]` positions.
fn answer(
    attack: AttackKind,
    observations: &[Observation],
    neighbours: &NeighbourLists,
    picture: &KeypointPicture,
    held: &Held,
    rng: &mut ChaCha8Rng,
) -> Result<Vec<Pixel>, AttackError> {
    let (width, height) = (picture.width, picture.height);
    let closed = |options: ClosedFormOptions| {
        let answers = closed_form(observations, neighbours, width, height, &options)?;
        Ok(answers.iter().map(|a| a.pixel).collect())
    };
    let transferred = || {
        let positions = held.transferred.as_ref().map(|t| t.projected(observations, width, height));
        positions.unwrap_or_else(|| prior_only(observations, width, height))
    };
    let laid_out = |options: GraphOptions, rng: &mut ChaCha8Rng| {
        Ok(graph(observations, neighbours, width, height, &options, rng)?.pixels)
    };
    match attack {
        AttackKind::Prior => Ok(prior_only(observations, width, height)),
        AttackKind::LearnedPrior => Ok(held.density.guess(observations, width, height)),
        AttackKind::ClosedForm => closed(ClosedFormOptions::default()),
        AttackKind::ClosedFormInPicture => closed(ClosedFormOptions::in_picture()),
        AttackKind::ClosedFormInformed => closed(ClosedFormOptions::informed()),
        AttackKind::ClosedFormConsensus => {
            closed(ClosedFormOptions::informed().with_consensus(CONSENSUS * f64::from(width)))
        }
        AttackKind::Transfer => Ok(transferred()),
        AttackKind::Graph => laid_out(GraphOptions::default(), rng),
        AttackKind::TransferGraph => laid_out(GraphOptions::default().beginning_at(transferred()), rng),
    }
}

fn summary(row: &Row, images: usize) -> AttackSummary {
    let errors = ErrorSummary::of(&row.errors);
    AttackSummary {
        scheme: row.scheme.to_string(),
        attack: row.attack.to_string(),
        corrupt: row.corrupt,
        images,
        mean_px: errors.mean_px,
        median_px: errors.median_px,
        under_5px: errors.under_5px,
        under_10px: errors.under_10px,
        under_30px: errors.under_30px,
        bits_over_prior: row.bits / row.errors.len().max(1) as f64,
        ms: median(&row.ms),
    }
}
