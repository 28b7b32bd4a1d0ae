//! Comparisons of synthetic runs with known differences.

use serde_json::json;

use super::*;

use crate::EvalError;

/// A run of one row; a non-finite error is a query without a pose.
fn run(scheme: &str, errors: &[(&str, u64, f64)]) -> String {
    let queries: Vec<_> = errors
        .iter()
        .map(|(name, seed, error)| {
            json!({
                "name": name, "scheme": scheme, "score": "likelihood", "prior": true, "fixed_hypotheses": null, "seed": seed,
                "rotation_error_deg": finite(10.0 * error), "translation_error": finite(*error), "inliers": 1,
                "ms": {"match": 2.0, "pose": 3.0},
            })
        })
        .collect();
    json!({
        "version": 1, "command": "eval scene", "data": ["place"],
        "schemes": [{"scheme": scheme, "recall": {"0.05/5": 1.0, "0.25/2": 1.0}}], "queries": queries,
    })
    .to_string()
}

fn read(scheme: &str, errors: &[(&str, u64, f64)]) -> Run {
    Run::parse(&run(scheme, errors)).expect("a document")
}

const NAMES: [&str; 12] = ["a", "b", "c", "d", "e", "f", "g", "h", "i", "j", "k", "l"];

fn errors(of: impl Fn(usize) -> f64) -> Vec<(&'static str, u64, f64)> {
    NAMES.iter().enumerate().map(|(i, name)| (*name, 0, of(i))).collect()
}

fn figure<'a>(comparison: &'a Comparison, name: &str) -> &'a ComparedFigure {
    comparison.rows[0].figures.iter().find(|f| f.figure == name).expect("a figure")
}

/// Difficult queries are difficult for both runs: a small gain on each query is detected in spite of a spread a
/// hundred times as large.
#[test]
fn small_gain_on_every_query_is_significant() {
    let a = read("dcl", &errors(|i| 0.01 * (i + 1) as f64));
    let b = read("dcl", &errors(|i| 0.0099 * (i + 1) as f64));
    let found = compare(&a, &b, &ComparisonOptions::default()).expect("compared");
    let translation = figure(&found, "median translation");
    assert_eq!(translation.result, ComparisonResult::BBetter);
    assert!((translation.a.unwrap() - 0.065).abs() < 1e-12 && translation.difference.unwrap() < 0.0);
    assert!(translation.low.unwrap() <= translation.high.unwrap());
    assert_eq!((found.rows[0].better_in_b, found.rows[0].worse_in_b), (12, 0));
    assert_eq!(figure(&found, "median time").result, ComparisonResult::NotShown);
    assert_eq!(figure(&found, "recall 0.05/5").a, Some(5.0 / 12.0));
    // In the other order the other run is better.
    let back = compare(&b, &a, &ComparisonOptions::default()).expect("compared");
    assert_eq!(figure(&back, "median translation").result, ComparisonResult::ABetter);
}

/// Symmetric noise is not a difference, and neither is a run compared with itself.
#[test]
fn symmetric_noise_is_not_significant() {
    let a = read("dcl", &errors(|i| 0.01 + 0.001 * (i % 5) as f64));
    let b = read("dcl", &errors(|i| 0.01 + 0.001 * ((i * 7 + 3) % 5) as f64));
    let found = compare(&a, &b, &ComparisonOptions::default()).expect("compared");
    assert!(found.rows[0].figures.iter().all(|f| f.result == ComparisonResult::NotShown), "{found:?}");
    let same = compare(&a, &a, &ComparisonOptions::default()).expect("compared");
    assert!(same.rows[0].figures.iter().all(|f| (f.low, f.high) == (Some(0.0), Some(0.0))));
    assert_eq!((same.rows[0].better_in_b, same.rows[0].worse_in_b), (0, 0));
}

/// Coverage of the interval: a run compared with one that has independent noise of the same spread.
#[test]
fn intervals_have_nominal_coverage() {
    let mut draw = ChaCha8Rng::seed_from_u64(1);
    let names: Vec<String> = (0..40).map(|i| i.to_string()).collect();
    let mut noise = || -> Vec<(&str, u64, f64)> {
        names.iter().map(|name| (name.as_str(), 0, draw.random_range(0.01..0.03))).collect()
    };
    let options = ComparisonOptions { draws: 300, ..ComparisonOptions::default() };
    let held = (0..200)
        .filter(|_| {
            let found = compare(&read("dcl", &noise()), &read("dcl", &noise()), &options).expect("compared");
            figure(&found, "median translation").result == ComparisonResult::NotShown
        })
        .count();
    assert!((180..=199).contains(&held), "{held} of 200");
}

#[test]
fn missing_poses_are_never_better() {
    let a = read("dcl", &errors(|_| 0.5));
    let b = read("dcl", &errors(|i| if i < 8 { f64::INFINITY } else { 0.001 }));
    let found = compare(&a, &b, &ComparisonOptions::default()).expect("compared");
    let translation = figure(&found, "median translation");
    assert_eq!((translation.b, translation.difference, translation.high), (None, None, None));
    assert!(found.table().contains("+∞"), "{}", found.table());
    assert_eq!(found.rows[0].worse_in_b, 8);
}

/// Seeds of a query are drawn together: repeating a run does not narrow the interval.
#[test]
fn seeds_of_a_query_are_resampled_together() {
    let width = |seeds: u64| {
        let of = |scale: f64| -> Vec<(&str, u64, f64)> {
            let one = |i: usize, name| {
                (0..seeds).map(move |seed| (name, seed, scale * (0.01 + 0.003 * ((i * 5) % 12) as f64)))
            };
            NAMES.iter().enumerate().flat_map(|(i, name)| one(i, *name)).collect()
        };
        let found = compare(&read("dcl", &of(1.0)), &read("dcl", &of(1.1)), &ComparisonOptions::default());
        let found = found.expect("compared");
        let translation = figure(&found, "median translation");
        translation.high.unwrap() - translation.low.unwrap()
    };
    assert!((width(1) - width(8)).abs() < 1e-12, "{} {}", width(1), width(8));
}

#[test]
fn rows_are_paired_by_name_or_option() {
    let a = read("points", &errors(|_| 0.01));
    let b = read("dcl", &errors(|_| 0.02));
    let only = compare(&a, &b, &ComparisonOptions::default()).expect("one row each");
    assert_eq!((only.rows[0].a.as_str(), only.rows[0].b.as_str()), ("points, likelihood", "dcl, likelihood"));
    let options_for = |rows: [Option<&str>; 2]| ComparisonOptions {
        rows: rows.map(|row| row.map(str::to_owned)),
        ..ComparisonOptions::default()
    };
    assert!(compare(&a, &b, &options_for([Some("points"), Some("dcl, likelihood")])).is_ok());
    let error = compare(&a, &b, &options_for([Some("dcl"), None])).unwrap_err();
    assert_eq!(
        error.to_string(),
        "no rows to compare: the first has points, likelihood; the second has dcl, likelihood"
    );
    let other = read("points", &[("elsewhere", 0, 0.1)]);
    let refused = compare(&a, &other, &ComparisonOptions::default());
    assert!(matches!(refused, Err(EvalError::NoQueries { row }) if row == "points, likelihood"));
}

#[test]
fn other_documents_are_refused_with_their_command() {
    let good = run("dcl", &errors(|_| 0.01));
    assert!(matches!(Run::parse(&good[..good.len() / 2]), Err(EvalError::Document(_))));
    assert!(matches!(Run::parse("[]"), Err(EvalError::Document(_))));
    let other = good.replace("eval scene", "eval stress");
    assert!(matches!(Run::parse(&other), Err(EvalError::NotCompared(command)) if command == "eval stress"));
    let later = good.replace("\"version\":1", "\"version\":2");
    assert!(matches!(Run::parse(&later), Err(EvalError::Version(2))));
    let twice = run("dcl", &[("a", 0, 0.1), ("a", 0, 0.2)]);
    assert!(matches!(Run::parse(&twice), Err(EvalError::Twice { .. })));
    assert!(Run::parse(&good.replace("0.05/5", "near")).is_err());
}
