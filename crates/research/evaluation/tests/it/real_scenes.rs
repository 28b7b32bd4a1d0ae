//! The whole pipeline on real images: map, seal, localize. Needs `VEILOC_DATA`.

use std::path::Path;

use veiloc_evaluation::pose::{Estimator, PoseEvaluation, evaluate_poses};
use veiloc_evaluation::results::{EvaluationDocument, LossStage, SchemeSummary};
use veiloc_evaluation::{SceneEvaluation, evaluate_scene};
use veiloc_map::colmap::read_posed;
use veiloc_protocol::Scheme;
use veiloc_testdata::real_data_test;

fn names(list: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(list).expect("a list of the data");
    text.lines().map(|l| l.trim().to_owned()).filter(|l| !l.is_empty()).collect()
}

fn scene(folder: &Path, every: usize, schemes: &[&str]) -> SceneEvaluation {
    // Every n-th image keeps the test short; the full figures are in docs/results/poses.md.
    let thin = |list: &str| names(&folder.join(list)).into_iter().step_by(every).collect();
    SceneEvaluation {
        schemes: schemes.iter().map(|s| s.parse().expect("a scheme")).collect(),
        thresholds: vec!["0.05/5".parse().expect("a threshold")],
        ..SceneEvaluation::of_scene(
            read_posed(&folder.join("posed")).expect("poses of the data"),
            folder.join("images"),
            thin("map.txt"),
            names(&folder.join("query.txt")).into_iter().step_by(3).collect(),
        )
    }
}

fn estimators(names: &[&str]) -> Vec<Estimator> {
    names.iter().map(|name| Estimator::named(name).expect("a name")).collect()
}

fn assert_recall(result: &EvaluationDocument, scheme: &str, least: f64, translation: f64) {
    let summary = result.schemes.iter().find(|s| s.scheme == scheme).expect("a requested row");
    let recall = summary.recall["0.05/5"];
    assert!(recall >= least, "{scheme}: recall {recall}, at least {least} is expected");
    let median = summary.median_translation.unwrap_or(f64::INFINITY);
    assert!(median <= translation, "{scheme}: median {median} m, at most {translation} is expected");
}

#[real_data_test]
fn redkitchen_is_localized_under_every_scheme(data: &Path) {
    let schemes = ["points", "random-lines", "dcl"];
    let result = evaluate_scene(&scene(&data.join("redkitchen"), 2, &schemes), &()).expect("evaluated");
    assert_recall(&result, "points", 0.99, 0.010);
    assert_recall(&result, "random-lines", 0.99, 0.015);
    assert_recall(&result, "dcl", 0.9, 0.025);
    let map = result.map.expect("a map was built");
    assert!(map.points > 3000, "{} points", map.points);
}

#[real_data_test]
fn herzjesu_is_localized_with_dcl(data: &Path) {
    let result = evaluate_scene(&scene(&data.join("herzjesu"), 1, &["dcl"]), &()).expect("evaluated");
    assert_recall(&result, "dcl", 0.99, 0.05);
}

/// The collapse described in DESIGN: with the plain score the false optimum at an anchor wins; the likelihood removes
/// it.
#[real_data_test]
fn likelihood_removes_collapse_of_plain_score(data: &Path) {
    let files = vec![data.join("problems/redkitchen_nn.jsonl.gz")];
    let mut evaluation = PoseEvaluation::new(files, vec![Scheme::default()]);
    evaluation.estimators = estimators(&["paper", "default"]);
    for estimator in &mut evaluation.estimators {
        estimator.localize.pose.fixed_hypotheses = Some(500);
    }
    evaluation.thresholds = vec!["0.05/5".parse().expect("a threshold")];
    let result = evaluate_poses(&evaluation, &()).expect("evaluated");
    let recall = |score: &str| {
        result.schemes.iter().find(|s| s.score == score).expect("a requested row").recall["0.05/5"]
    };
    assert!(recall("msac") < 0.3, "the plain score did not collapse: {}", recall("msac"));
    assert!(recall("likelihood") > 0.85, "the likelihood did not cure it: {}", recall("likelihood"));
}

/// Every estimator runs on the same real matches; estimators with the true matches have smaller errors than those that
/// must find them.
#[real_data_test]
fn estimators_seeds_and_the_floor_on_real_matches(data: &Path) {
    let files = vec![data.join("problems/redkitchen_r08.jsonl.gz")];
    let mut evaluation =
        PoseEvaluation::new(files, vec![Scheme::Points, "dcl:paper".parse().expect("a layout")]);
    evaluation.estimators = estimators(&["paper", "default", "floor"]);
    evaluation.thresholds = vec!["0.05/5".parse().expect("a threshold")];
    evaluation.seeds = 2;
    let result = evaluate_poses(&evaluation, &()).expect("evaluated");
    let row = |scheme: &str, recipe: &str| {
        let of_recipe =
            |s: &&SchemeSummary| s.scheme == scheme && s.variant.recipe.as_deref() == Some(recipe);
        result.schemes.iter().find(of_recipe).expect("a requested row")
    };
    let median = |scheme, recipe| row(scheme, recipe).median_translation.unwrap_or(f64::INFINITY);
    assert_eq!(row("points", "default").recall["0.05/5"], 1.0);
    assert!(median("points", "floor") < median("points", "default"));
    assert!(
        row("dcl:paper", "default").recall["0.05/5"] > 0.8
            && row("dcl:paper", "paper").recall["0.05/5"] < 0.3
    );
    assert_eq!(result.queries.len(), 2 * 3 * 2 * 22);
    assert!(result.schemes.iter().all(|s| s.per_seed.len() == 2 && s.queries == 44));
}

/// Every pose is beyond a threshold of a nanometre: with the usual matches by the objective, and with hardly any matches
/// by the matching.
#[real_data_test]
fn stages_of_lost_queries_differ(data: &Path) {
    let mut evaluation = scene(&data.join("entry"), 1, &["points", "dcl"]);
    evaluation.thresholds = vec!["1e-9/1e-9".parse().expect("a threshold")];
    let stages = |evaluation: &SceneEvaluation| -> Vec<Option<LossStage>> {
        let result = evaluate_scene(evaluation, &()).expect("evaluated");
        result.queries.iter().map(|query| query.lost_in).collect()
    };
    assert_eq!(stages(&evaluation), [Some(LossStage::Objective); 2]);
    evaluation.estimators[0].localize.matching.max_ratio = Some(0.05);
    assert_eq!(stages(&evaluation), [Some(LossStage::Matching); 2]);
    evaluation.thresholds = vec!["1e9/180".parse().expect("a threshold")];
    evaluation.estimators[0].localize.matching.max_ratio = None;
    assert_eq!(stages(&evaluation), [None; 2]);
}
