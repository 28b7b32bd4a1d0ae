//! Runs every attack on every image and scheme.

use veiloc_datasets::problem_files::{KeypointImage, json_lines, read_keypoints, synthetic_image};
use veiloc_features::Progress;
use veiloc_geometry::Pixel;
use veiloc_obfuscation::{KnownPlace, PackUse};

use super::attacks::{Attack, Knowledge};
use super::context::{AttackContext, ImageParts};
use super::document::{AttackDocument, WithPack};
use super::neighbours::{NeighbourSource, Precision};
use super::options::{AttackEvaluation, ImageGroup};
use super::rows::{Row, check, rows};
use super::scene::{Attacker, Scene};
use super::server::ServerStatistics;
use super::with_pack::sent_with_pack;
use crate::EvalError;

/// One attack on one image under one scheme. Slices are `[N]`, one entry per keypoint, in the image's order.
#[derive(Clone, Copy)]
pub struct AttackTrial<'a> {
    /// What the attack was given.
    pub context: &'a AttackContext<'a>,
    /// The image; its keypoints are the ground truth.
    pub image: &'a KeypointImage,
    /// The image's group in the document's `data`, and its index there.
    pub at: (usize, usize),
    /// Index in the document's `attacks`.
    pub row: usize,
    /// The attack.
    pub attack: Attack,
    /// Recovered keypoints, pixels; may lie outside the image or not be finite.
    pub answers: &'a [Pixel],
    /// Distance of answer and truth, pixels; infinite without an answer.
    pub errors: &'a [f64],
}

/// Runs all attacks, as a stage with this name. `observe` sees each of them: the document holds summaries, but a report
/// that draws images needs the single keypoints. Trials come in the order of the work: group, image, row of the document.
///
/// Groups come first in the document's `data`, then the files, then the synthetic image.
///
/// # Errors
/// [`EvalError`] when a file cannot be read, is empty, or has a keypoint that no scheme can send.
pub fn evaluate_attacks(
    evaluation: &AttackEvaluation,
    stage: &str,
    progress: &dyn Progress,
    observe: &mut dyn FnMut(&AttackTrial<'_>),
) -> Result<AttackDocument, EvalError> {
    check(evaluation)?;
    let most = evaluation.images.unwrap_or(usize::MAX);
    let mut read = evaluation.groups.clone();
    read.extend(read_groups(evaluation)?);
    let with_pack =
        evaluation.place.as_ref().map(|(place, usage)| send_with_pack(place, *usage, &mut read, most));
    let with_pack = with_pack.transpose()?;
    let groups = || read.iter();
    let attacked: Vec<&KeypointImage> = groups().flat_map(|group| group.images.iter().take(most)).collect();
    let attacker = Attacker::new(evaluation, &attacked)?;
    if evaluation.needs(Knowledge::Network).is_some() {
        attacker.networks.check_features(&attacked)?;
    }
    let posed = attacker.schemes.iter().filter(|_| attacker.server.is_some());
    let statistics = posed.map(|_| ServerStatistics::default()).collect();
    let mut results = Results { rows: rows(&attacker), precision: Precision::default(), statistics };
    progress.start(stage, attacked.len() * results.rows.len());
    for (index, group) in groups().enumerate() {
        let scene = Scene::new(&attacker, index, &group.images);
        for own in 0..group.images.len().min(most) {
            attack_image(&scene, own, &mut results, &mut |trial| {
                observe(trial);
                progress.advance(1);
            })?;
        }
    }
    progress.finish();
    let of_schemes = results.statistics.iter().zip(&attacker.schemes);
    let server = of_schemes.map(|(one, scheme)| one.summary(*scheme)).collect::<Result<_, _>>()?;
    let precision = results.precision.shares();
    Ok(AttackDocument {
        version: 1,
        command: "attack",
        data: groups().map(|group| group.name.clone()).collect(),
        neighbours: evaluation.neighbours.kind(),
        k: evaluation.k,
        precision: precision.map(|shares| shares.0),
        chance: precision.map(|shares| shares.1),
        server,
        frame_selection: evaluation.needs(Knowledge::Frames).map(|_| evaluation.choice),
        with_pack,
        seed: evaluation.seed,
        attacks: results.rows.iter().map(Row::summary).collect(),
    })
}

/// Leaves of the attacked images what a device with the pack sends.
fn send_with_pack(
    place: &KnownPlace,
    usage: PackUse,
    groups: &mut [ImageGroup],
    most: usize,
) -> Result<WithPack, EvalError> {
    let mut counts = WithPack { send: usage.name(), keypoints: 0, sent: 0, images_not_sent: 0 };
    for image in groups.iter_mut().flat_map(|group| group.images.iter_mut().take(most)) {
        counts.keypoints += image.keypoints.len();
        *image = sent_with_pack(place, usage, image)?;
        counts.sent += image.keypoints.len();
        counts.images_not_sent += usize::from(image.keypoints.is_empty());
    }
    Ok(counts)
}

/// The groups that are not in memory.
fn read_groups(evaluation: &AttackEvaluation) -> Result<Vec<ImageGroup>, EvalError> {
    let mut groups = Vec::new();
    for file in &evaluation.files {
        groups.push(ImageGroup { name: json_lines::display_name(file), images: read_keypoints(file)? });
    }
    if evaluation.synthetic > 0 {
        let images = vec![synthetic_image(evaluation.synthetic, evaluation.seed)];
        groups.push(ImageGroup { name: format!("synthetic {}", evaluation.synthetic), images });
    }
    Ok(groups)
}

/// What is accumulated over images.
struct Results {
    rows: Vec<Row>,
    precision: Precision,
    /// By scheme; empty without a server.
    statistics: Vec<ServerStatistics>,
}

/// Runs all attacks on one image, scheme by scheme.
fn attack_image(
    scene: &Scene<'_>,
    own: usize,
    results: &mut Results,
    observe: &mut dyn FnMut(&AttackTrial<'_>),
) -> Result<(), EvalError> {
    let (attacker, image, parts) = (scene.attacker, &scene.images[own], ImageParts::default());
    if attacker.evaluation.place.is_some() && image.keypoints.is_empty() {
        return Ok(());
    }
    for (at, scheme) in attacker.schemes.iter().enumerate() {
        let mut context = AttackContext::new(scene, own, &parts, *scheme)?;
        if at == 0 && attacker.evaluation.neighbours != NeighbourSource::Oracle {
            results.precision.add(context.given_neighbours()?, &context.true_neighbours());
        }
        if let Some(statistics) = results.statistics.get_mut(at) {
            statistics.add(&context.sent, &image.keypoints);
        }
        for (index, row) in results.rows.iter_mut().enumerate().filter(|(_, row)| row.scheme == *scheme) {
            (context.corrupt, context.frames) = (row.corrupt, row.frames.unwrap_or(0));
            let (found, duration) = context.timed(row.attack.run);
            let found = found?;
            let errors = row.add(&context, &found, duration)?;
            observe(&AttackTrial {
                context: &context,
                image,
                at: (scene.group, own),
                row: index,
                attack: row.attack,
                answers: &found.pixels,
                errors: &errors,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use veiloc_attacks::{ErrorSummary, bits_over_prior};
    use veiloc_protocol::Scheme;

    use super::*;

    #[test]
    fn observed_trials_add_up_to_the_document() {
        let mut own = synthetic_image(200, 9);
        own.name = "own".to_owned();
        let mut evaluation = AttackEvaluation {
            groups: vec![ImageGroup { name: "memory".to_owned(), images: vec![own] }],
            synthetic: 200,
            schemes: vec![Scheme::RandomLines, Scheme::default()],
            attacks: vec![Attack::CLOSED_FORM, Attack::CLOSED_FORM],
            corrupt: vec![0.0, 50.0],
            seed: 3,
            ..AttackEvaluation::default()
        };
        // Two schemes; the baseline, and the closed form once at each of two shares of false neighbours.
        let (mut errors, mut bits, mut order) = (vec![Vec::new(); 6], 0.0, Vec::new());
        let mut observe = |trial: &AttackTrial<'_>| {
            let (context, truth) = (trial.context, &trial.image.keypoints);
            for (i, truth) in truth.iter().enumerate() {
                assert!((trial.answers[i].distance(truth) - trial.errors[i]).abs() < 1e-9);
                // The sent line passes through the keypoint up to the dither and the quantized angle.
                assert!(context.observations()[i].distance(*truth) < 2.0);
            }
            if trial.row == 5 {
                bits += bits_over_prior(trial.errors, context.prior_errors(), 640, 480) / 2.0;
            }
            order.push((trial.at, trial.row));
            errors[trial.row].extend_from_slice(trial.errors);
        };
        let document = evaluate_attacks(&evaluation, "", &(), &mut observe).expect("it runs");
        assert_eq!(document.data, ["memory", "synthetic 200"]);
        assert_eq!(
            order,
            [0, 1]
                .map(|group| (0..6).map(move |row| ((group, 0), row)))
                .into_iter()
                .flatten()
                .collect::<Vec<_>>()
        );
        for (row, errors) in document.attacks.iter().zip(&errors) {
            let sum = ErrorSummary::of(errors);
            assert!((row.mean_px - sum.mean_px).abs() < 1e-9 && row.median_px == sum.median_px, "{row:?}");
        }
        let last = &document.attacks[5];
        assert_eq!((&*last.scheme, last.attack, last.corrupt), ("dcl", Attack::CLOSED_FORM, 50.0));
        assert!((last.bits_over_prior - bits).abs() < 1e-9, "{document:?}");

        evaluation.groups.clear();
        let alone = evaluate_attacks(&evaluation, "", &(), &mut |_| {}).expect("it runs");
        assert_eq!(alone.data, ["synthetic 200"]);
        assert!(alone.attacks.iter().zip(&document.attacks).all(|(a, b)| a.images == 1 && b.images == 2));
    }
}
