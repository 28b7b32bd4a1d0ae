//! The paper's Table 1 end to end, on drawn images and networks that learned for a few steps.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use veiloc_evaluation::EvalError;
use veiloc_evaluation::inversion::evaluation::{
    EvaluationDocument, InversionEvaluation, Judges, Realistic, Sheet, SummaryRow, evaluate_inversion,
    evaluation_table,
};
use veiloc_evaluation::inversion::{
    Course, Form, InversionTask, Inverter, Sees, Shape, read_examples, train,
};
use veiloc_features::Sift;
use veiloc_protocol::{ExtractionLimits, Scheme};

/// Squares on a slope, with corners for SIFT to find.
fn draw(folder: &Path, shift: u32) -> PathBuf {
    let value = |x: u32, y: u32| {
        let square = ((x + shift) / 9 * 37 + (y + 2 * shift) / 7 * 61) % 5 * 40;
        image::Rgb([square as u8, (x + 60) as u8, (y + 90) as u8])
    };
    let path = folder.join(format!("image-{shift}.png"));
    image::RgbImage::from_fn(128, 96, value).save(&path).expect("written");
    path
}

fn network(paths: &[PathBuf], form: Form, sees: Sees) -> Inverter {
    let shape = Shape { form, dimension: 128, width: 2, depth: 2, side: 32, sees };
    let scheme = (sees == Sees::Lines).then(Scheme::default);
    let task = InversionTask::new(shape, scheme).expect("it can be");
    let limits = ExtractionLimits::default();
    let read = |paths: &[PathBuf]| {
        read_examples(paths, &Sift::default(), limits, &task, &()).expect("images of SIFT keypoints")
    };
    let course =
        Course { steps: 4, images: 2, learning_rate: 1e-3, weight_decay: 0.0, validate_every: 2, seed: 0 };
    let on = |_: veiloc_evaluation::inversion::Progress<'_>| ControlFlow::Continue(());
    train(&read(&paths[..2]), &read(&paths[2..3]), &task, &course, None, on).expect("trained").network
}

fn evaluate(
    images: &[PathBuf],
    networks: &[Inverter],
    realistic: Realistic,
) -> Result<(EvaluationDocument, [Sheet; 2]), EvalError> {
    let evaluation = InversionEvaluation {
        images: images.to_vec(),
        schemes: vec![Scheme::Points, Scheme::RandomLines, Scheme::default()],
        networks,
        extractor: &Sift::default(),
        limits: ExtractionLimits::default(),
        realistic,
        k: 10,
        seed: 3,
        shown: 1,
    };
    evaluate_inversion(&evaluation, &Judges::default(), &())
}

#[test]
fn every_scheme_and_attack_has_its_rows() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let paths: Vec<PathBuf> = (0..6).map(|i| draw(folder.path(), 31 * i)).collect();
    let networks = [Sees::Places, Sees::Lines, Sees::Bag].map(|sees| network(&paths, Form::UNet, sees));
    let limits = ExtractionLimits::default();
    let map = veiloc_datasets::problem_files::keypoints_of_images(&paths[5..], &Sift::default(), limits, &())
        .expect("images");
    let (document, sheets) =
        evaluate(&paths[3..5], &networks, Realistic { map, ..Realistic::default() }).expect("it runs");
    let names: Vec<String> =
        document.summary.iter().map(|row| format!("{} {}", row.scheme, row.attack)).collect();
    let dcl = Scheme::default().to_string();
    let expected = [
        "points none",
        "random-lines guess",
        "random-lines closed-form",
        "random-lines graph",
        "random-lines realistic",
        &format!("{dcl} guess"),
        &format!("{dcl} closed-form"),
        &format!("{dcl} graph"),
        &format!("{dcl} realistic"),
        &format!("{dcl} lines"),
        "bag none",
        "nothing none",
    ];
    assert_eq!(names, expected);
    assert_eq!(document.rows.len(), 2 * expected.len());
    let row =
        |name: &str| -> &SummaryRow { &document.summary[names.iter().position(|n| n == name).expect(name)] };
    assert_eq!((row("points none").mean_px, row("points none").median_px), (Some(0.0), Some(0.0)));
    let graph = row("random-lines graph").mean_px.expect("places");
    assert!(graph > 0.0 && graph < row("random-lines guess").mean_px.expect("places"), "{graph}");
    assert_eq!(row("random-lines realistic").by.as_deref(), Some("transfer"));
    for name in ["bag none", "nothing none"] {
        assert_eq!((row(name).mean_px, row(name).median_px), (None, None));
    }
    for row in &document.rows {
        assert!(row.psnr > 0.0 && row.psnr < 60.0 && row.ssim < 1.0, "{row:?}");
        assert_eq!((row.lpips, row.feature_distance, row.objects), (None, None, None), "nobody judged it");
    }
    let of = |scheme: &str, attack: &str| {
        let own = document.rows.iter().filter(|row| row.scheme == scheme && row.attack == attack);
        own.map(|row| row.psnr).sum::<f64>() / 2.0
    };
    assert!((of("points", "none") - row("points none").psnr).abs() < 1e-9);

    let [sheet, wide] = sheets;
    assert_eq!(sheet.columns.len(), 1 + expected.len());
    assert_eq!(wide.columns.len(), 1 + 9, "what is given places");
    for sheet in [&sheet, &wide] {
        assert_eq!((sheet.rows.len(), sheet.rows[0].len()), (1, sheet.columns.len()), "one image is shown");
    }
    let side = |sheet: &Sheet| sheet.rows[0][1].image.width();
    assert_eq!((side(&sheet), side(&wide)), (32, 64));
    assert!(sheet.png().expect("small").expect("tiles").starts_with(b"\x89PNG"));
    let table = evaluation_table(&document);
    assert!(table.contains("realistic (transfer)") && table.contains("Means over 2 images"), "{table}");

    assert!(document.summary.iter().all(|row| row.told_apart.is_none()) && !table.contains("told apart"));

    // Three stages say of places what they believe.
    let staged = [network(&paths, Form::InvSfm, Sees::Places)];
    let of_staged = evaluate(&paths[3..5], &staged, Realistic::default()).expect("it runs").0;
    assert_eq!(of_staged.networks[0].form, "invsfm");
    for row in &of_staged.summary {
        // Keypoints as they are hold nothing wrong, graph may bring all back, and where nothing is given nothing is judged.
        match (row.scheme.as_str(), row.attack) {
            ("points" | "nothing", _) => assert_eq!(row.told_apart, None, "{row:?}"),
            (_, "guess" | "closed-form") => assert!(row.told_apart.is_some(), "{row:?}"),
            _ => {}
        }
        assert!(row.told_apart.is_none_or(|told| told > 0.0 && told < 1.0), "{row:?}");
    }
    assert!(evaluation_table(&of_staged).contains("told apart"));

    // The same again to the last digit.
    let again = evaluate(&paths[3..5], &networks[..1], Realistic::default()).expect("it runs").0;
    let psnr = |d: &EvaluationDocument| d.rows.iter().find(|r| r.attack == "graph").map(|r| r.psnr);
    assert_eq!(psnr(&again), psnr(&document), "other networks and attackers change nothing");

    let none =
        evaluate(&paths[3..4], &networks[1..], Realistic::default()).expect_err("no network for places");
    assert!(none.to_string().contains("none of the networks takes places"), "{none}");
    let alike = [networks[0].clone(), staged[0].clone()];
    let two = evaluate(&paths[3..4], &alike, Realistic::default()).expect_err("one of them would go unused");
    assert!(two.to_string().contains("two of the networks are given places"), "{two}");
}
