//! Recall on the real correspondence sets of `$VEILOC_DATA/problems`: the collapse of MSAC on anchored lines, and the
//! likelihood, which avoids it.
#![expect(clippy::print_stderr, reason = "prints the measured recall")]

use super::support::problems as support;

use std::path::Path;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::{Query, obfuscate, read};
use veiloc_descriptor::DescriptorKind;
use veiloc_descriptor::match_probability;
use veiloc_pose::{PoseOptions, PoseProblem, ScoreKind, estimate_pose};
use veiloc_testdata::real_data_test;

/// Share of the queries within the threshold, 1000 hypotheses each.
fn recall(queries: &[Query], scheme: &str, score: ScoreKind, prior: bool, threshold: (f64, f64)) -> f64 {
    let fitted = DescriptorKind::ROOT_SIFT.match_prior();
    let mut options = PoseOptions::default();
    options.score = Some(score);
    options.fixed_hypotheses = Some(1000);
    let hit = |(index, query): &(usize, &Query)| {
        let mut rng = ChaCha8Rng::seed_from_u64(*index as u64);
        let observations = obfuscate(query, scheme, &mut rng);
        let mut problem =
            PoseProblem::new(query.camera, observations, query.keypoints.clone(), query.points.clone());
        problem.prior = prior.then(|| query.evidence.iter().map(|e| match_probability(&fitted, e)).collect());
        estimate_pose(&problem, &options, &mut rng).is_ok_and(|e| {
            e.cam_from_world.translation_error(&query.truth) <= threshold.0
                && e.cam_from_world.rotation_error_degrees(&query.truth) <= threshold.1
        })
    };
    let hits = queries.iter().enumerate().filter(hit).count();
    let share = hits as f64 / queries.len() as f64;
    eprintln!("{scheme} {score} prior {prior}: {:.1} %", 100.0 * share);
    share
}

#[real_data_test]
fn recall_on_real_matches(data: &Path) {
    for (file, threshold, plain, weighted) in
        [("redkitchen_nn", (0.05, 5.0), 0.85, 0.9), ("herzjesu_nn", (0.1, 1.0), 0.9, 0.96)]
    {
        let queries = read(data.join(format!("problems/{file}.jsonl.gz"))).expect("readable problems");
        assert!(queries.len() > 20);
        let at = |scheme, score, prior| recall(&queries, scheme, score, prior, threshold);
        assert!(at("points", ScoreKind::Msac, false) >= 0.99);
        assert!(at("lines", ScoreKind::Likelihood, true) >= weighted);
        assert!(at("dcl", ScoreKind::Msac, false) <= 0.2, "the collapse");
        assert!(at("dcl", ScoreKind::Likelihood, false) >= plain, "the likelihood");
        assert!(at("dcl", ScoreKind::Likelihood, true) >= weighted, "the likelihood with the prior");
    }
}
