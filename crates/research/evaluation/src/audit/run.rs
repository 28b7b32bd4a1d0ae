//! Runs every attack on every scheme and image.

use std::collections::BTreeMap;
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::multi_view::RestingOptions;
use veiloc_attacks::{
    Density, Descriptors, KnownImage, NeighbourLists, Observation, KeypointHistogram, Transfer, bits_over_prior,
    errors_px,
};
use veiloc_protocol::{Observations, Scheme};

use super::attacks::Attack;
use super::attempt::Attempt;
use super::document::AttackDocument;
use super::gate::narrowed;
use super::neighbours::{NeighbourSource, Precision, descriptors, from_others, known};
use super::observer::{AttackObserver, AttackTrial, ImageGroup, Progress};
use super::options::AttackEvaluation;
use super::outsider::TrainedPositions;
use super::rows::{Row, check, rows, summary};
use super::server::{Server, Tally, send, send_again};
use super::view::View;
use veiloc_datasets::problem_files::json_lines;
use veiloc_datasets::problem_files::seed_for;
use veiloc_datasets::problem_files::{KeypointImage, read_keypoints, synthetic_image};

use crate::EvalError;

/// The sent observations of an image under one scheme, and the errors of its baseline.
struct Sent {
    scheme: Scheme,
    observed: Observations,
    observations: Vec<Observation>,
    guess_errors: Vec<f64>,
}

/// The attacker's knowledge about one image, beside the sent observations.
struct Held<'a> {
    density: Density,
    neighbours: NeighbourLists,
    /// Predicted neighbours of each row in order of likelihood, if an attack restricts them.
    ranked: Option<NeighbourLists>,
    transferred: Option<Transfer>,
    descriptors: Option<Descriptors>,
    trained: &'a TrainedPositions,
    /// Index of the image in the file.
    own: usize,
    /// Images of the file with descriptors, if an attack reads them.
    images: &'a [KnownImage],
    /// Views of the file's images by scheme, if there is a server.
    views: &'a BTreeMap<String, Vec<View>>,
}

/// Runs all attacks; `advance` is called with the finished and the total work.
///
/// # Errors
/// [`EvalError`] when a file cannot be read, is empty, or has a keypoint that no scheme can send.
pub fn evaluate_attacks(
    evaluation: &AttackEvaluation,
    advance: impl FnMut(usize, usize),
) -> Result<AttackDocument, EvalError> {
    attack_groups(evaluation, Vec::new(), &mut Progress(advance))
}

/// Runs all attacks on `groups` and on the files of the evaluation, and reports to an observer.
///
/// Groups come first in the document's `data`, then the files, then the synthetic image.
///
/// # Errors
/// As [`evaluate_attacks`].
pub fn attack_groups(
    evaluation: &AttackEvaluation,
    groups: Vec<ImageGroup>,
    observer: &mut dyn AttackObserver,
) -> Result<AttackDocument, EvalError> {
    check(evaluation)?;
    let server = evaluation.server.as_ref().map(Server::new).transpose()?;
    let (mut data, mut groups): (Vec<String>, Vec<Vec<KeypointImage>>) =
        groups.into_iter().map(|g| (g.name, g.images)).unzip();
    for file in &evaluation.files {
        groups.push(read_keypoints(file)?);
        data.push(json_lines::display_name(file));
    }
    if evaluation.synthetic > 0 {
        groups.push(vec![synthetic_image(evaluation.synthetic, evaluation.seed)]);
        data.push(format!("synthetic {}", evaluation.synthetic));
    }

    let trained = TrainedPositions::read(&evaluation.positions)?;
    let mut rows = rows(evaluation, &trained);
    let images: usize = groups.iter().map(|g| g.len().min(evaluation.images.unwrap_or(usize::MAX))).sum();
    let total = images * rows.len();
    let mut done = 0;
    let most = evaluation.images.unwrap_or(usize::MAX);
    let attacked: Vec<&KeypointImage> = groups.iter().flat_map(|g| g.iter().take(most)).collect();
    let predictor = evaluation.neighbours.learn(&attacked, evaluation.k)?;
    let transfers = evaluation.neighbours == NeighbourSource::Transferred
        || evaluation.attacks.iter().any(|a| a.needs.map_images);
    let several = evaluation.attacks.iter().any(|a| a.needs.frames);
    let narrows = evaluation.attacks.iter().any(|a| a.needs.near_angles);
    let by_training = evaluation.attacks.iter().any(|a| a.needs.trained);
    let mut precision = Precision::default();
    let mut tallies: BTreeMap<String, Tally> = BTreeMap::new();
    for (group_index, group) in groups.iter().enumerate() {
        let counts: Vec<KeypointHistogram> =
            group.iter().map(|p| KeypointHistogram::of(&p.keypoints, p.width, p.height)).collect();
        let mut all = KeypointHistogram::default();
        for counts in &counts {
            all.add(counts);
        }
        let map: Vec<KnownImage> = if transfers || several {
            group.iter().map(known).collect::<Result<_, _>>()?
        } else {
            Vec::new()
        };
        let views = match &server {
            // Every image of the file can be one of several frames.
            Some(server) => {
                seen(evaluation, server, &group[..if several { group.len() } else { most.min(group.len()) }])?
            }
            None => BTreeMap::new(),
        };
        for (i, (image, own)) in group.iter().zip(&counts).take(most).enumerate() {
            let mut others = all.clone();
            others.subtract(own);
            let size = (image.width, image.height);
            let transferred = if transfers { Some(from_others(&map, i, size, evaluation.k)?) } else { None };
            let nearest = NeighbourLists::nearest(&image.keypoints, evaluation.k);
            let ranked = match &predictor {
                Some(predictor) if narrows => {
                    Some(predictor.predict(&descriptors(image)?, image.keypoints.len().saturating_sub(1))?)
                }
                _ => None,
            };
            let neighbours = match (&predictor, &transferred) {
                (Some(predictor), _) => predictor.predict(&descriptors(image)?, evaluation.k)?,
                (None, Some(t)) if evaluation.neighbours == NeighbourSource::Transferred => {
                    t.neighbours.clone()
                }
                _ => nearest.clone(),
            };
            precision.add(&neighbours, &nearest);
            for (scheme, views) in &views {
                tallies.entry(scheme.clone()).or_default().add(&views[i], &image.keypoints);
            }
            let density = others.density();
            let descriptors = if by_training { Some(descriptors(image)?) } else { None };
            let held = Held {
                trained: &trained,
                descriptors,
                density,
                neighbours,
                ranked,
                transferred,
                own: i,
                images: &map,
                views: &views,
            };
            attack_image(evaluation, (group_index, image), &held, &mut rows, &mut |trial| {
                observer.saw(trial);
                done += 1;
                observer.advance(done, total);
            })?;
        }
    }
    let oracle = evaluation.neighbours == NeighbourSource::Oracle;
    let told = precision.shares().filter(|_| !oracle);
    let tally = |scheme: &Scheme| tallies.get(&scheme.to_string()).map(|tally| tally.summary(*scheme));
    let server = evaluation.schemes.iter().filter_map(tally).collect::<Result<_, _>>()?;
    Ok(AttackDocument {
        version: 1,
        command: "attack",
        data,
        neighbours: evaluation.neighbours.kind(),
        k: evaluation.k,
        precision: told.map(|t| t.0),
        chance: told.map(|t| t.1),
        server,
        choice: several.then_some(evaluation.choice),
        seed: evaluation.seed,
        attacks: rows.iter().map(|row| summary(row, images)).collect(),
    })
}

/// Views of these images by scheme.
fn seen(
    evaluation: &AttackEvaluation,
    server: &Server<'_>,
    images: &[KeypointImage],
) -> Result<BTreeMap<String, Vec<View>>, EvalError> {
    let mut views = BTreeMap::new();
    for scheme in evaluation.schemes.iter().filter(|s| s.hides_positions()) {
        let of_scheme = images.iter().map(|p| server.view(evaluation, p, *scheme));
        views.insert(scheme.to_string(), of_scheme.collect::<Result<_, _>>()?);
    }
    Ok(views)
}

/// The attacker's model of the angle codes of several seals.
fn codes(evaluation: &AttackEvaluation) -> RestingOptions {
    let cell = std::f64::consts::PI / f64::from(evaluation.angle_bits.levels());
    RestingOptions::of_one_image(cell).with_noise(evaluation.resting_noise_px)
}

fn attack_image(
    evaluation: &AttackEvaluation,
    (group, image): (usize, &KeypointImage),
    held: &Held<'_>,
    rows: &mut [Row],
    attacked: &mut dyn FnMut(&AttackTrial<'_>),
) -> Result<(), EvalError> {
    let truth = &image.keypoints;
    let mut sent: Option<Sent> = None;
    for row in rows {
        let name = row.scheme.to_string();
        // The seed depends on image and scheme only, so other schemes or attacks do not change the result.
        let rng =
            |what: &str| ChaCha8Rng::seed_from_u64(seed_for(evaluation.seed, &[&image.name, &name, what]));
        let view = held.views.get(&name).map(|views| &views[held.own]);
        if sent.as_ref().is_none_or(|s| s.scheme != row.scheme) {
            let (observed, observations) = if let Some(view) = view {
                (view.observed.clone(), view.observations.clone())
            } else {
                let observed = send(evaluation, image, row.scheme)?;
                let observations = Observation::of_sent(&observed);
                (observed, observations)
            };
            sent = Some(Sent { scheme: row.scheme, observed, observations, guess_errors: Vec::new() });
        }
        let Some(sent) = &mut sent else { continue };
        let narrowed = match &held.ranked {
            Some(ranked) if row.attack.needs.near_angles => {
                Some(narrowed(ranked, &sent.observations, evaluation.k)?)
            }
            _ => None,
        };
        let told = narrowed.as_ref().unwrap_or(&held.neighbours);
        let corrupted = told.corrupted(row.corrupt / 100.0, &mut rng("corrupted"));
        let seals: Vec<Vec<Observation>> = if row.attack.needs.seals {
            let more = 1..row.frames.unwrap_or(1);
            more.map(|k| send_again(evaluation, image, row.scheme, k)).collect::<Result<_, _>>()?
        } else {
            Vec::new()
        };
        let started = Instant::now();
        let attempt = Attempt {
            observations: &sent.observations,
            neighbours: &corrupted,
            size: (image.width, image.height),
            density: &held.density,
            transferred: held.transferred.as_ref(),
            images: held.images,
            own: held.own,
            frames: row.frames,
            choice: evaluation.choice,
            seals: &seals,
            codes: codes(evaluation),
            descriptors: held.descriptors.as_ref(),
            trained: held.trained,
            scheme: row.scheme,
            name: &image.name,
            views: held.views.get(&name).map_or(&[], Vec::as_slice),
        };
        let answers = (row.attack.run)(&attempt, &mut rng("attack"))?;
        if answers.pixels.len() != truth.len() {
            return Err(EvalError::Options(format!(
                "the attack {} answered {} of {} keypoints",
                row.attack,
                answers.pixels.len(),
                truth.len()
            )));
        }
        row.ms.push(started.elapsed().as_secs_f64() * 1e3);
        let counts = |i: usize| view.is_none_or(|v| v.measured[i]);
        let all = errors_px(answers.pixels.iter().copied(), truth);
        if let Some(believed) = &answers.believed {
            let sure = (0..all.len()).filter(|i| counts(*i) && believed[*i]).map(|i| all[i]);
            row.believed.get_or_insert_default().extend(sure);
        }
        let errors: Vec<f64> = (0..all.len()).filter(|i| counts(*i)).map(|i| all[i]).collect();
        if row.attack == Attack::PRIOR {
            sent.guess_errors.clone_from(&errors);
        }
        if !errors.is_empty() {
            let bits = bits_over_prior(&errors, &sent.guess_errors, image.width, image.height);
            row.bits += bits * errors.len() as f64;
        }
        attacked(&AttackTrial {
            group,
            image,
            scheme: row.scheme,
            attack: row.attack,
            corrupt: row.corrupt,
            sent: &sent.observed,
            observations: &sent.observations,
            neighbours: &corrupted,
            answers: &answers.pixels,
            errors: &all,
        });
        row.errors.extend(errors);
    }
    Ok(())
}
