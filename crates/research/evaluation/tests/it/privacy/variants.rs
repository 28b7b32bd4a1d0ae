//! The trade-off on three small images: figures found by other means, results that repeat, and files that do not fit.

use std::path::PathBuf;

use base64::Engine as _;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use veiloc_evaluation::EvalError;
use veiloc_evaluation::privacy::variants::{
    TradeoffDocument, TradeoffEvaluation, Variant, evaluate_tradeoff, tradeoff_table,
};

const KEYPOINTS: usize = 240;
/// Matches are those of the even keypoints.
const MATCHES: usize = KEYPOINTS / 2;

/// One image: its line of keypoints, its problem. The matches of a lost image are all wrong.
fn image(name: &str, lost: bool) -> (Value, Value) {
    let mut rng = ChaCha8Rng::seed_from_u64(u64::from(name.as_bytes()[0]));
    let (mut keypoints, mut points2d, mut points3d, mut ratio) = (vec![], vec![], vec![], vec![]);
    let t = [0.1, -0.2, 0.3];
    for i in 0..KEYPOINTS {
        // On a lattice of 1/8 px, so that every position is a short number.
        let at = |rng: &mut ChaCha8Rng, size: u32| f64::from(rng.random_range(8..8 * size - 8)) / 8.0;
        let (u, v) = (at(&mut rng, 640), at(&mut rng, 480));
        let depth = rng.random_range(2.0..6.0);
        keypoints.push([u, v]);
        if i % 2 == 0 {
            let (u, v) = if lost { (at(&mut rng, 640), at(&mut rng, 480)) } else { (u, v) };
            points2d.push(keypoints[i]);
            points3d.push([
                (u - 320.0) / 500.0 * depth - t[0],
                (v - 240.0) / 500.0 * depth - t[1],
                depth - t[2],
            ]);
            ratio.push(if i % 3 == 0 { 0.7 } else { 0.95 });
        }
    }
    let bytes: Vec<u8> = (0..KEYPOINTS * 128).map(|_| rng.random_range(0..90)).collect();
    let descriptors = base64::engine::general_purpose::STANDARD.encode(bytes);
    let imaged = json!({"name": name, "width": 640, "height": 480, "keypoints": keypoints, "descriptor_dim": 128,
        "descriptors": descriptors});
    let camera = json!({"model": "PINHOLE", "width": 640, "height": 480, "params": [500, 500, 320, 240]});
    let problem = json!({"name": name, "camera": camera, "points2d": points2d, "points3d": points3d, "ratio": ratio,
        "cam_from_world": {"q": [1, 0, 0, 0], "t": t}});
    (imaged, problem)
}

struct Files {
    _folder: tempfile::TempDir,
    keypoints: PathBuf,
    problems: PathBuf,
}

fn files(change: impl Fn(usize, &mut Value, &mut Value)) -> Files {
    let folder = tempfile::tempdir().expect("temporary folder");
    let (mut keypoints, mut problems) = (Vec::new(), Vec::new());
    for (i, name) in ["a", "b", "c"].into_iter().enumerate() {
        let (mut imaged, mut problem) = image(name, name == "c");
        change(i, &mut imaged, &mut problem);
        keypoints.push(imaged.to_string());
        problems.push(problem.to_string());
    }
    let path = |name: &str, lines: &[String]| {
        let path = folder.path().join(name);
        std::fs::write(&path, lines.join("\n")).expect("written");
        path
    };
    Files { keypoints: path("k.jsonl", &keypoints), problems: path("p.jsonl", &problems), _folder: folder }
}

fn evaluation(files: &Files, variants: &[&str]) -> TradeoffEvaluation {
    let mut evaluation = TradeoffEvaluation::new(files.keypoints.clone(), files.problems.clone());
    evaluation.variants = variants.iter().map(|v| v.parse::<Variant>().expect("well written")).collect();
    evaluation.thresholds = vec!["0.1/2".parse().expect("well written")];
    evaluation.corrupt = vec![0.0];
    evaluation
}

fn run(files: &Files, variants: &[&str]) -> TradeoffDocument {
    evaluate_tradeoff(&evaluation(files, variants), &()).expect("it runs")
}

/// Expected distance of an evenly spread keypoint on its half-line, and from that the error of the guess.
fn error_of_guess([u, v]: [f64; 2]) -> f64 {
    let anchor = if u <= 320.0 { [320.0, 0.0] } else { [320.0, 480.0] };
    let (du, dv) = (u - anchor[0], v - anchor[1]);
    let r = du.hypot(dv);
    // The anchor lies on the border: the half-line is in the image from there until it meets an edge.
    let far = [320.0 / du.abs(), 480.0 / dv.abs()].into_iter().fold(f64::INFINITY, f64::min) * r;
    (2.0 / 3.0 * far - r).abs()
}

#[test]
fn figures_are_those_found_by_other_means() {
    let files = files(|_, _, _| {});
    let document = run(&files, &["dcl", "first=150", "known=0.8", "random=100+bits=8", "decoys=50"]);
    let [plain, first, known, lot, decoys] = &document.variants[..] else { panic!("five variants") };
    let sent: Vec<f64> = document.variants.iter().map(|v| v.sent).collect();
    // Of the even keypoints every third has a ratio of 0.7.
    assert_eq!(sent, [240.0, 150.0, 40.0, 100.0, 240.0]);
    assert_eq!((plain.decoys, decoys.decoys), (0.0, 120.0));
    let matches: Vec<f64> = document.variants.iter().map(|v| v.localization.matches).collect();
    assert_eq!(
        (matches[0], matches[1], matches[2], matches[4]),
        (MATCHES as f64, 75.0, 40.0, MATCHES as f64)
    );
    assert!((30.0..70.0).contains(&matches[3]), "half of a lot of 100: {matches:?}");

    // Two images of three can be localized.
    for v in [plain, first, known, decoys] {
        assert!((v.localization.recall["0.1/2"] - 2.0 / 3.0).abs() < 1e-12, "{v:?}");
        assert!(v.localization.median_translation.is_some_and(|t| t < 0.1));
    }
    assert!((lot.chance - 20.0 / 99.0).abs() < 1e-12 && (decoys.chance - 20.0 / 359.0).abs() < 1e-12);

    let mut expected: Vec<f64> = Vec::new();
    for name in ["a", "b", "c"] {
        let (imaged, _) = image(name, name == "c");
        let all: Vec<[f64; 2]> = serde_json::from_value(imaged["keypoints"].clone()).expect("positions");
        expected.extend(all.into_iter().map(error_of_guess));
    }
    expected.sort_by(f64::total_cmp);
    let guess = plain.attack("guess").expect("it is there");
    // The dither turns lines by half a pixel or so; the share within 10 px moves with it.
    let median = f64::midpoint(expected[359], expected[360]);
    assert!((guess.median_px.expect("some") - median).abs() < 2.0, "{guess:?} {median}");
    assert!((guess.median_share.expect("some") - median / 800.0).abs() < 2.0 / 800.0);
    let near = expected.iter().filter(|e| **e < 10.0).count() as f64 / 3.0;
    assert!((guess.found_10px - near).abs() < 3.0, "{guess:?} {near}");
    for attack in &plain.attacks {
        assert!((attack.found_30px - 240.0 * attack.under_30px.expect("some")).abs() < 1e-9);
    }
    let graph = plain.attack("graph").expect("it ran");
    assert!(graph.under_30px > guess.under_30px && graph.shape_median_px <= graph.median_px, "{graph:?}");
    assert!(plain.attack("transfer").is_some(), "the other images are a map");

    let table = tradeoff_table(&document);
    for word in ["240+120", "known=0.8", "≤0.1/2 %", "66.7", "transfer"] {
        assert!(table.contains(word), "{word}\n{table}");
    }
}

#[test]
fn equal_seeds_give_equal_results_whatever_the_number_of_threads() {
    let files = files(|_, _, _| {});
    let once = |threads: usize, seed: u64| {
        let mut evaluation = evaluation(&files, &["line=random", "random=80+noise=2+decoys=30"]);
        evaluation.seed = seed;
        evaluation.seeds = 2;
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| evaluate_tradeoff(&evaluation, &())).expect("it runs")
    };
    let (one, three, other) = (once(1, 5), once(3, 5), once(1, 6));
    assert_eq!(one, three);
    assert_ne!(one.variants, other.variants);
    assert_eq!(one.variants[0].localization.queries, 6);
}

#[test]
fn a_predictor_is_taught_by_other_images() {
    let own = files(|_, _, _| {});
    let other = files(|i, imaged, problem| (*imaged, *problem) = image(["x", "y", "z"][i], false));
    let mut evaluation = evaluation(&own, &["dcl"]);
    evaluation.attacked = Some(1);
    assert_eq!(evaluate_tradeoff(&evaluation, &()).expect("it runs").variants[0].precision, None);
    evaluation.train = vec![other.keypoints.clone()];
    let document = evaluate_tradeoff(&evaluation, &()).expect("it runs");
    assert_eq!((document.attacked, document.queries, document.train_images), (1, 3, 3));
    // Descriptors drawn at random tell nothing.
    let (precision, chance) =
        (document.variants[0].precision.expect("predicted"), document.variants[0].chance);
    assert!((precision - chance).abs() < 0.5 * chance, "{precision} {chance}");
    evaluation.train = vec![own.keypoints.clone()];
    let error = evaluate_tradeoff(&evaluation, &()).expect_err("taught by itself");
    assert!(error.to_string().contains("other images"), "{error}");
}

#[test]
fn files_that_do_not_belong_together_are_refused() {
    let refused = |files: &Files, says: &str| {
        let error = evaluate_tradeoff(&evaluation(files, &["dcl"]), &()).expect_err(says);
        assert!(matches!(error, EvalError::DataSet(_)) && error.to_string().contains(says), "{error}");
    };
    refused(&files(|i, _, problem| problem["name"] = json!(i.to_string())), "no image name in common");
    refused(&files(|_, imaged, _| drop(imaged["descriptors"].take())), "without descriptors");
    refused(&files(|_, imaged, _| imaged["width"] = json!(641)), "641 x 480");
    let moved = files(|i, imaged, _| {
        if i == 1 {
            imaged["keypoints"][0] = json!([1.0, 1.0]);
        }
    });
    refused(&moved, "b: a match is at");
    let nothing = evaluate_tradeoff(&evaluation(&files(|_, _, _| {}), &[]), &()).expect_err("no variant");
    assert!(matches!(nothing, EvalError::Options(_)), "{nothing}");
}
