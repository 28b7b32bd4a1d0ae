//! Outsiders with networks: from description files to rows of the table, and messages about missing ones.

use std::path::{Path, PathBuf};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::{KeypointImage, encode_keypoints};
use veiloc_descriptor::{DescriptorError, DescriptorKind, Descriptors, Encoding};
use veiloc_evaluation::EvalError;
use veiloc_evaluation::attack_evaluation::{
    ATTACKS, Attack, AttackDocument, AttackEvaluation, NeighbourSource, evaluate_attacks,
};
use veiloc_geometry::Pixel;

/// Folder of the networks of `research/oracles/tiny_networks.py`.
fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../attacks/tests/data/learned").join(name)
}

/// Images whose descriptors encode which of 4 x 3 fields a keypoint is in.
fn file(folder: &Path) -> PathBuf {
    file_of(folder, "keypoints.jsonl", DescriptorKind::new("made-up", 12, Encoding::Unsigned, 200))
}

/// The same with descriptors of a kind of 12 numbers.
fn file_of(folder: &Path, name: &str, kind: Result<DescriptorKind, DescriptorError>) -> PathBuf {
    let kind = kind.expect("a kind");
    let images: Vec<KeypointImage> = (0..2)
        .map(|seed| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let keypoints: Vec<Pixel> = (0..160)
                .map(|_| Pixel::new(rng.random_range(0.0..320.0), rng.random_range(0.0..240.0)))
                .collect();
            let field = |p: &Pixel| (p.u / 80.0) as usize + 4 * (p.v / 80.0) as usize;
            let number = |of: bool| kind.encoding().byte(if of { 100.0 } else { 0.0 });
            let bytes = keypoints.iter().flat_map(|p| (0..12).map(move |i| number(i == field(p)))).collect();
            let descriptors = Some(Descriptors::new(kind, bytes).expect("whole rows"));
            KeypointImage { name: format!("image-{seed}"), width: 320, height: 240, keypoints, descriptors }
        })
        .collect();
    let path = folder.join(name);
    std::fs::write(&path, encode_keypoints(&images, false).expect("encoded")).expect("written");
    path
}

fn run(evaluation: &AttackEvaluation) -> Result<AttackDocument, EvalError> {
    evaluate_attacks(evaluation, "", &(), &mut |_| {})
}

fn attack(name: &str) -> Attack {
    *ATTACKS.iter().find(|a| a.name == name).expect("an attack")
}

#[test]
fn position_network_attacks_its_scheme() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let model = data("positions.toml");
    let mut evaluation = AttackEvaluation {
        files: vec![file(folder.path())],
        schemes: ["random-lines", "dcl:paper"].map(|s| s.parse().expect("a scheme")).to_vec(),
        attacks: vec![attack("trained-positions")],
        positions: vec![model.clone()],
        ..AttackEvaluation::default()
    };
    let found = run(&evaluation).expect("attacked").attacks;
    let rows: Vec<(String, Attack)> = found.iter().map(|r| (r.scheme.clone(), r.attack)).collect();
    let expected = [
        ("random-lines", Attack::PRIOR),
        ("dcl:paper", Attack::PRIOR),
        ("dcl:paper", attack("trained-positions")),
    ];
    assert_eq!(rows, expected.map(|(s, a)| (s.to_owned(), a)), "no network of random lines");
    assert!(found[2].bits_over_prior > 0.7, "{:?}", found[2]);

    evaluation.positions = vec![model.clone(), data("untrained.toml")];
    let twice = run(&evaluation).expect_err("two of one scheme").to_string();
    assert!(twice.contains("two networks are given for dcl"), "{twice}");
    evaluation.positions = Vec::new();
    let none = run(&evaluation).expect_err("no network").to_string();
    assert!(none.contains("research/train"), "{none}");
    evaluation.positions = vec![evaluation.files[0].clone()];
    let other = run(&evaluation).expect_err("no network").to_string();
    assert!(other.contains("keypoints.jsonl") && other.contains("does not describe"), "{other}");
    evaluation.positions = vec![data("neighbours.toml")];
    let other = run(&evaluation).expect_err("another kind").to_string();
    assert!(other.contains("neighbours.toml") && other.contains("\"positions\" is required"), "{other}");
}

#[test]
fn neighbour_network_predicts_neighbours() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let evaluation = AttackEvaluation {
        files: vec![file(folder.path())],
        schemes: vec!["dcl".parse().expect("a scheme")],
        attacks: vec![Attack::CLOSED_FORM],
        neighbours: NeighbourSource::Network { model: data("neighbours.onnx") },
        k: 8,
        ..AttackEvaluation::default()
    };
    let found = run(&evaluation).expect("attacked");
    let text = serde_json::to_string(&found).expect("a document");
    assert!(text.contains("\"neighbours\":\"network\""), "{text}");
    // Eight of a field with about thirteen keypoints: far above chance.
    let (precision, chance) = (found.precision, found.chance);
    assert!(precision.zip(chance).is_some_and(|(precision, chance)| precision > 4.0 * chance), "{text}");
}

/// A file names the kind of its descriptors; data of another kind is refused.
#[test]
fn descriptors_of_another_kind_are_refused() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let own = file(folder.path());
    let other =
        file_of(folder.path(), "other.jsonl", DescriptorKind::new("other", 12, Encoding::Unsigned, 200));
    let evaluation = |neighbours: NeighbourSource, positions: Vec<PathBuf>| AttackEvaluation {
        files: vec![other.clone()],
        schemes: vec!["dcl".parse().expect("a scheme")],
        attacks: vec![if positions.is_empty() { Attack::CLOSED_FORM } else { attack("trained-positions") }],
        neighbours,
        positions,
        k: 8,
        ..AttackEvaluation::default()
    };
    let predicted =
        |train: &[&PathBuf]| NeighbourSource::Predicted { train: train.iter().copied().cloned().collect() };
    let network = NeighbourSource::Network { model: data("neighbours.toml") };
    for (neighbours, positions, expected_words) in [
        (
            predicted(&[&own]),
            Vec::new(),
            "image-0: its descriptors are of kind other, but kind made-up is required",
        ),
        (
            predicted(&[&own, &other]),
            Vec::new(),
            "other.jsonl: its descriptors are of kind other, but kind made-up is required",
        ),
        (network, Vec::new(), "image-0: its descriptors are of kind other, but kind made-up is required"),
        (NeighbourSource::Oracle, vec![data("positions.toml")], "--features made-up"),
    ] {
        let refused = run(&evaluation(neighbours, positions)).expect_err("another kind");
        assert!(refused.to_string().contains(expected_words), "{refused}");
    }
    // Training images with the names of attacked images are left out, so they need other names.
    let text = std::fs::read_to_string(&other).expect("text").replace("image-", "training-");
    let more = folder.path().join("more.jsonl");
    std::fs::write(&more, text).expect("written");
    run(&evaluation(predicted(&[&more]), Vec::new())).expect("one kind");
}

/// The offset of signed numbers is not part of a descriptor.
#[test]
fn encoding_of_descriptors_does_not_change_attacks() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let found = [Encoding::Unsigned, Encoding::Signed].map(|encoding| {
        let file =
            file_of(folder.path(), "keypoints.jsonl", DescriptorKind::new("made-up", 12, encoding, 200));
        let evaluation = AttackEvaluation {
            files: vec![file],
            schemes: vec!["dcl".parse().expect("a scheme")],
            attacks: vec![attack("trained-positions")],
            positions: vec![data("positions.toml")],
            ..AttackEvaluation::default()
        };
        let found = run(&evaluation).expect("attacked").attacks;
        found.iter().map(|row| row.bits_over_prior).collect::<Vec<f64>>()
    });
    assert_eq!(found[0], found[1]);
}
