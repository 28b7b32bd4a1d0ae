//! `veiloc train` from files to figures: nothing learned from is judged, networks attack, and what is missing is said.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::{KeypointImage, encode_keypoints};
use veiloc_evaluation::audit::training::{
    ImageSets, NeighbourRun, PositionRun, PositionTask, Progress, Sees, TrainingOptions, position_table,
    train_neighbours, train_positions, training_table,
};
use veiloc_evaluation::audit::{ATTACKS, Attack, AttackEvaluation, evaluate_attacks};
use veiloc_geometry::Pixel;

/// Images whose descriptors tell which of 4 x 3 fields a keypoint is in.
fn file(folder: &Path, name: &str, seeds: std::ops::Range<u64>) -> PathBuf {
    let images: Vec<KeypointImage> = seeds
        .map(|seed| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let keypoints: Vec<Pixel> = (0..160)
                .map(|_| Pixel::new(rng.random_range(0.0..320.0), rng.random_range(0.0..240.0)))
                .collect();
            let field = |p: &Pixel| (p.u / 80.0) as usize + 4 * (p.v / 80.0) as usize;
            let bytes = keypoints
                .iter()
                .flat_map(|p| (0..12).map(move |i| 200 * u8::from(i == field(p))))
                .map(|x| x + rng.random_range(0..40))
                .collect();
            let name = format!("{name}-{seed}");
            KeypointImage { name, width: 320, height: 240, keypoints, descriptors: Some((bytes, 12)) }
        })
        .collect();
    let path = folder.join(format!("{name}.jsonl"));
    std::fs::write(&path, encode_keypoints(&images, false).expect("encoded")).expect("written");
    path
}

fn sets(folder: &Path) -> ImageSets {
    ImageSets {
        train: vec![file(folder, "train", 0..6)],
        validate: vec![file(folder, "validate", 10..12)],
        test: vec![file(folder, "test", 20..22), file(folder, "other", 30..31)],
        validation_images: 2,
    }
}

fn options(steps: usize) -> TrainingOptions {
    let mut options = TrainingOptions::default();
    (options.steps, options.images, options.keypoints) = (steps, 1, 80);
    (options.width, options.heads, options.layers) = (24, 2, 1);
    (options.learning_rate, options.validate_every, options.dropout) = (5e-3, 40, 0.0);
    options
}

fn on(_: Progress<'_>) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

#[test]
fn positions_are_learned_judged_and_attacked() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let mut task = PositionTask::new("dcl".parse().expect("a scheme")).expect("it hides");
    (task.sees, task.crop) = (Sees::Row, false);
    let run = PositionRun { sets: sets(folder.path()), task, options: options(160) };
    let (network, _, document) = train_positions(&run, None, on).expect("it learns");
    let parts: Vec<(&str, &str, usize)> =
        document.told.iter().map(|r| (r.part, r.data.as_str(), r.images)).collect();
    assert_eq!(parts, [("validate", "all", 2), ("test", "test.jsonl", 2), ("test", "other.jsonl", 1)]);
    assert_eq!((document.images, document.steps_done, document.curve.len()), ([6, 2, 3], 160, 4));
    for row in &document.told {
        assert!(row.information_bits > 0.5 && row.by_image.len() == row.images, "{row:?}");
        assert!(row.median_px < row.guess_median_px, "{row:?}");
    }
    let table = position_table(&document);
    assert!(table.contains("test.jsonl") && table.contains("dcl, seeing the row"), "{table}");

    let model = folder.path().join("dcl.net");
    std::fs::write(&model, network.encode()).expect("written");
    let attack = |name: &str| *ATTACKS.iter().find(|a| a.name == name).expect("an attack");
    let mut evaluation = AttackEvaluation {
        files: run.sets.test.clone(),
        schemes: ["random-lines", "dcl"].map(|s| s.parse().expect("a scheme")).to_vec(),
        attacks: vec![attack("trained-positions")],
        positions: vec![model.clone()],
        ..AttackEvaluation::default()
    };
    let found = evaluate_attacks(&evaluation, |_, _| ()).expect("attacked").attacks;
    let rows: Vec<(String, Attack)> = found.iter().map(|r| (r.scheme.clone(), r.attack)).collect();
    let expected =
        [("random-lines", Attack::PRIOR), ("dcl", Attack::PRIOR), ("dcl", attack("trained-positions"))];
    assert_eq!(rows, expected.map(|(s, a)| (s.to_owned(), a)), "no network of random lines");
    assert!(found[2].bits_over_prior > 0.3, "{:?}", found[2]);

    evaluation.positions = vec![model.clone(), model.clone()];
    let twice = evaluate_attacks(&evaluation, |_, _| ()).expect_err("two of one scheme").to_string();
    assert!(twice.contains("another network of dcl"), "{twice}");
    evaluation.positions = Vec::new();
    let none = evaluate_attacks(&evaluation, |_, _| ()).expect_err("no network").to_string();
    assert!(none.contains("train positions"), "{none}");
    evaluation.positions = vec![run.sets.train[0].clone()];
    let other = evaluate_attacks(&evaluation, |_, _| ()).expect_err("no network").to_string();
    assert!(other.contains("this is no network of positions"), "{other}");
}

#[test]
fn neighbours_are_judged_with_angles_and_without() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = NeighbourRun { sets: sets(folder.path()), neighbours: 8, options: options(80) };
    let (_, _, document) = train_neighbours(&run, None, on).expect("it learns");
    let of = |part: &str, predictor: &str| {
        let row = document.precision.iter().find(|r| r.part == part && r.predictor == predictor);
        row.unwrap_or_else(|| panic!("{part} {predictor}: {:?}", document.precision)).clone()
    };
    for part in ["validate", "test"] {
        let [network, gated, angles] = ["network", "network, angles", "angles"].map(|p| of(part, p));
        // 160 keypoints: 13 of a field, of which twenty nearest are some thirteen.
        assert!(network.at_5 > 0.4 && angles.at_20 > 1.5 * angles.chance, "{network:?} {angles:?}");
        assert!(gated.at_5 > angles.at_5, "{gated:?} {angles:?}");
        assert!((angles.at_5 - angles.at_20).abs() < 1e-9);
        of(part, "statistic");
        of(part, "statistic, angles");
    }
    assert_eq!(of("test", "network").by_image.len(), 3);
    assert!(training_table(&document).contains("network, angles"));
}

#[test]
fn an_image_in_two_sets_is_refused_whatever_it_is_called() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let task = PositionTask::new("dcl".parse().expect("a scheme")).expect("it hides");
    let says = |sets: ImageSets| {
        let run = PositionRun { sets, task, options: options(1) };
        train_positions(&run, None, on).expect_err("refused").to_string()
    };
    let mut shared = sets(folder.path());
    // The same images under other names.
    shared.test.push(file(folder.path(), "renamed", 5..7));
    assert!(says(shared).contains("--train and of --test"));
    let mut shared = sets(folder.path());
    shared.validate = vec![file(folder.path(), "again", 0..1)];
    assert!(says(shared).contains("--train and of --validate"));
    let mut shared = sets(folder.path());
    shared.test = vec![file(folder.path(), "chosen", 10..11)];
    assert!(says(shared).contains("--validate and of --test"));
}
