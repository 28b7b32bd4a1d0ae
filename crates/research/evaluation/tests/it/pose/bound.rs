//! Synthetic evaluation: the estimator is near the bound, and results are reproducible.
use veiloc_evaluation::EvalError;
use veiloc_evaluation::pose::crb::{BoundEvaluation, SyntheticEvaluation, SyntheticScene, evaluate_bound};
use veiloc_protocol::Scheme;

fn small() -> SyntheticEvaluation {
    let mut evaluation = SyntheticEvaluation::default();
    evaluation.scenes = vec![SyntheticScene::Deep];
    evaluation.noises_px = vec![1.0];
    evaluation.outlier_shares = vec![0.3];
    evaluation.problems = 120;
    evaluation.matches = 200;
    evaluation
}

fn run(evaluation: &SyntheticEvaluation) -> BoundEvaluation {
    evaluate_bound(evaluation, &()).expect("evaluated")
}

/// A median of 120 is accurate to 8 %: outside of 0.75 to 1.35 either the estimator or the bound is wrong.
#[test]
fn errors_are_near_the_bound_and_covariance_covers_them() {
    let document = run(&small());
    assert_eq!(document.cells.len(), 3);
    for cell in &document.cells {
        assert!(cell.found > 0.95 && cell.inlier_recall > 0.9, "{cell:?}");
        for ratio in [cell.translation_ratio, cell.rotation_ratio, cell.translation_ratio_all] {
            assert!(ratio.is_some_and(|r| (0.75..1.35).contains(&r)), "{cell:?}");
        }
    }
    assert_eq!(document.coverage.len(), 6, "three schemes, and each over all");
    for row in &document.coverage {
        assert!(row.poses > 110, "{row:?}");
        for shares in [&row.pose, &row.center] {
            assert!(shares["50"] < shares["90"] && shares["90"] <= shares["99"], "{row:?}");
            assert!((0.25..0.75).contains(&shares["50"]) && shares["99"] > 0.9, "{row:?}");
        }
    }
}

/// Scaling of the bound: twice the noise, twice the errors; four times the matches, half the errors.
#[test]
fn bound_scales_with_noise_and_matches() {
    let mut evaluation = small();
    evaluation.schemes = vec![Scheme::Points];
    evaluation.noises_px = vec![2.0, 4.0];
    let bound = |document: &BoundEvaluation, i: usize| document.cells[i].bound_translation.expect("finite");
    let document = run(&evaluation);
    // Dither adds a twelfth to the variance: 2.021 and 4.011 pixels.
    let ratio = bound(&document, 1) / bound(&document, 0);
    assert!((ratio / 1.985 - 1.0).abs() < 0.1, "{ratio}");
    evaluation.noises_px = vec![2.0];
    evaluation.matches = 800;
    let ratio = bound(&document, 0) / bound(&run(&evaluation), 0);
    assert!((ratio / 2.0 - 1.0).abs() < 0.1, "{ratio}");
}

#[test]
fn document_is_independent_of_threads() {
    let mut evaluation = small();
    evaluation.problems = 12;
    let text = |document: &BoundEvaluation| serde_json::to_string(document).expect("a document");
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    let alone = one.install(|| text(&run(&evaluation)));
    assert_eq!(alone, text(&run(&evaluation)));
    evaluation.seed = 1;
    assert_ne!(alone, text(&run(&evaluation)));
}

#[test]
fn impossible_options_are_refused() {
    let refused = |change: fn(&mut SyntheticEvaluation), expected: &str| {
        let mut evaluation = small();
        change(&mut evaluation);
        match evaluate_bound(&evaluation, &()) {
            Err(EvalError::Options(reason)) => assert!(reason.contains(expected), "{reason}"),
            other => panic!("{expected}: {:?}", other.map(|d| d.cells.len())),
        }
    };
    refused(|e| e.noises_px = vec![f64::NAN], "noise");
    refused(|e| e.noises_px = vec![-1.0], "noise");
    refused(|e| e.outlier_shares = vec![1.0], "outliers");
    refused(|e| e.matches = 10, "use more matches");
    refused(|e| e.schemes.clear(), "no scene, scheme");
    refused(|e| e.problems = 0, "no scene, scheme");
}
