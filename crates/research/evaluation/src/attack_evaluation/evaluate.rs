//! Runs every attack on every scheme and image.

use std::collections::BTreeMap;
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::multi_view::RestingOptions;
use veiloc_attacks::{
    DecodedDescriptors, Density, KeypointHistogram, KnownImage, NeighbourLists, Observation,
    TransferredPositions, bits_over_prior, errors_px,
};
use veiloc_protocol::{Observations, Scheme};

use super::angle_gate::restricted_by_angle;
use super::attacks::Attack;
use super::context::AttackInput;
use super::document::AttackDocument;
use super::neighbours::{NeighbourSource, Precision, descriptors, from_others, known};
use super::observer::{AttackObserver, AttackTrial, ImageGroup, Progress};
use super::options::AttackEvaluation;
use super::position_networks::TrainedPositions;
use super::rows::{Row, check, rows, summary};
use super::server::{Server, ServerStatistics, reseal_image, seal_image};
use super::server_view::ServerView;
use veiloc_datasets::problem_files::json_lines;
use veiloc_datasets::problem_files::seed_for;
use veiloc_datasets::problem_files::{KeypointImage, read_keypoints, synthetic_image};

use crate::EvalError;
use crate::results::metrics::roc_auc;

/// The sent observations of an image under one scheme, and the errors of its baseline.
struct SentImage {
    scheme: Scheme,
    observed: Observations,
    observations: Vec<Observation>,
    prior_errors: Vec<f64>,
}

/// The attacker's knowledge about one image, beside the sent observations.
struct AttackInputs<'a> {
    density: Density,
    neighbours: NeighbourLists,
    /// Predicted neighbours of each row in order of likelihood, if an attack restricts them.
    ranked: Option<NeighbourLists>,
    transferred: Option<TransferredPositions>,
    descriptors: Option<DecodedDescriptors>,
    trained: &'a TrainedPositions,
    /// Index of the image in the file.
    own: usize,
    /// Images of the file with descriptors, if an attack reads them.
    images: &'a [KnownImage],
    /// Views of the file's images by scheme, if there is a server.
    views: &'a BTreeMap<String, Vec<ServerView>>,
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
    if by_training {
        trained.check_features(&attacked)?;
    }
    let mut precision = Precision::default();
    let mut statistics: BTreeMap<String, ServerStatistics> = BTreeMap::new();
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
            Some(server) => server_views(
                evaluation,
                server,
                &group[..if several { group.len() } else { most.min(group.len()) }],
            )?,
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
                statistics.entry(scheme.clone()).or_default().add(&views[i], &image.keypoints);
            }
            let density = others.density();
            let descriptors = if by_training { Some(descriptors(image)?) } else { None };
            let inputs = AttackInputs {
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
            attack_image(evaluation, (group_index, image), &inputs, &mut rows, &mut |trial| {
                observer.saw(trial);
                done += 1;
                observer.advance(done, total);
            })?;
        }
    }
    let oracle = evaluation.neighbours == NeighbourSource::Oracle;
    let given = precision.shares().filter(|_| !oracle);
    let one = |scheme: &Scheme| statistics.get(&scheme.to_string()).map(|one| one.summary(*scheme));
    let server = evaluation.schemes.iter().filter_map(one).collect::<Result<_, _>>()?;
    Ok(AttackDocument {
        version: 1,
        command: "attack",
        data,
        neighbours: evaluation.neighbours.kind(),
        k: evaluation.k,
        precision: given.map(|t| t.0),
        chance: given.map(|t| t.1),
        server,
        frame_selection: several.then_some(evaluation.choice),
        seed: evaluation.seed,
        attacks: rows.iter().map(|row| summary(row, images)).collect(),
    })
}

/// Views of these images by scheme.
fn server_views(
    evaluation: &AttackEvaluation,
    server: &Server<'_>,
    images: &[KeypointImage],
) -> Result<BTreeMap<String, Vec<ServerView>>, EvalError> {
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
    inputs: &AttackInputs<'_>,
    rows: &mut [Row],
    attacked: &mut dyn FnMut(&AttackTrial<'_>),
) -> Result<(), EvalError> {
    let truth = &image.keypoints;
    let mut sent: Option<SentImage> = None;
    for row in rows {
        let name = row.scheme.to_string();
        // The seed depends on image and scheme only, so other schemes or attacks do not change the result.
        let rng =
            |what: &str| ChaCha8Rng::seed_from_u64(seed_for(evaluation.seed, &[&image.name, &name, what]));
        let view = inputs.views.get(&name).map(|views| &views[inputs.own]);
        if sent.as_ref().is_none_or(|s| s.scheme != row.scheme) {
            let (observed, observations) = if let Some(view) = view {
                (view.observed.clone(), view.observations.clone())
            } else {
                let observed = seal_image(evaluation, image, row.scheme)?;
                let observations = Observation::of_sent(&observed);
                (observed, observations)
            };
            sent = Some(SentImage { scheme: row.scheme, observed, observations, prior_errors: Vec::new() });
        }
        let Some(sent) = &mut sent else { continue };
        let restricted_by_angle = match &inputs.ranked {
            Some(ranked) if row.attack.needs.near_angles => {
                Some(restricted_by_angle(ranked, &sent.observations, evaluation.k)?)
            }
            _ => None,
        };
        let given = restricted_by_angle.as_ref().unwrap_or(&inputs.neighbours);
        let corrupted = given.corrupted(row.corrupt / 100.0, &mut rng("corrupted"));
        let seals: Vec<Vec<Observation>> = if row.attack.needs.seals {
            let more = 1..row.frames.unwrap_or(1);
            more.map(|k| reseal_image(evaluation, image, row.scheme, k)).collect::<Result<_, _>>()?
        } else {
            Vec::new()
        };
        let started = Instant::now();
        let attempt = AttackInput {
            observations: &sent.observations,
            neighbours: &corrupted,
            size: (image.width, image.height),
            density: &inputs.density,
            transferred: inputs.transferred.as_ref(),
            images: inputs.images,
            own: inputs.own,
            frames: row.frames,
            choice: evaluation.choice,
            seals: &seals,
            codes: codes(evaluation),
            descriptors: inputs.descriptors.as_ref(),
            trained: inputs.trained,
            scheme: row.scheme,
            name: &image.name,
            views: inputs.views.get(&name).map_or(&[], Vec::as_slice),
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
        if let Some(accepted) = &answers.accepted {
            let sure = (0..all.len()).filter(|i| counts(*i) && accepted[*i]).map(|i| all[i]);
            row.accepted.get_or_insert_default().extend(sure);
        }
        let errors: Vec<f64> = (0..all.len()).filter(|i| counts(*i)).map(|i| all[i]).collect();
        if let (Some(hiding), Some(view)) = (&answers.hiding, view) {
            let unexplained = |i: &usize| view.known[*i].is_none() && !view.ignored[*i];
            let (own, others): (Vec<usize>, Vec<usize>) =
                (0..all.len()).filter(unexplained).partition(|i| view.measured[*i]);
            let of = |rows: &[usize]| rows.iter().map(|i| hiding[*i]).collect::<Vec<f64>>();
            row.hiding_auc.extend(roc_auc(&of(&own), &of(&others)));
        }
        if row.attack == Attack::PRIOR {
            let best = errors_px(attempt.prior_only(), truth);
            sent.prior_errors = (0..best.len()).filter(|i| counts(*i)).map(|i| best[i]).collect();
        } else if !errors.is_empty() {
            let bits = bits_over_prior(&errors, &sent.prior_errors, image.width, image.height);
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
