//! The paper's Tables 2 and 7 end to end, on synthetic images and tiny networks.

use std::path::{Path, PathBuf};

use veiloc_datasets::problem_files::KeypointImage;
use veiloc_evaluation::EvalError;
use veiloc_evaluation::attack_evaluation::inversion::{
    Classifier, ContactSheet, ImageMetrics, InversionDocument, InversionEvaluation, InversionNetwork,
    PerceptualDistance, SummaryRow, evaluate_inversion, evaluation_table,
};
use veiloc_evaluation::attack_evaluation::{Attack, AttackEvaluation};
use veiloc_features::{Compact, Extractor, Sift};
use veiloc_protocol::{ExtractionLimits, Scheme};

/// Folder of the networks of `research/oracles/tiny_networks.py`.
fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../attacks/tests/data").join(name)
}

fn network(name: &str) -> InversionNetwork {
    InversionNetwork::open(&data(name)).expect("a network")
}

/// Squares on a ramp, with corners for SIFT.
fn draw(folder: &Path, shift: u32) -> PathBuf {
    let value = |x: u32, y: u32| {
        let square = ((x + shift) / 9 * 37 + (y + 2 * shift) / 7 * 61) % 5 * 40;
        image::Rgb([square as u8, (x + 60) as u8, (y + 90) as u8])
    };
    let path = folder.join(format!("image-{shift}.png"));
    image::RgbImage::from_fn(128, 96, value).save(&path).expect("written");
    path
}

fn evaluate(
    images: &[PathBuf],
    network: &InversionNetwork,
    map: Vec<KeypointImage>,
    metrics: &ImageMetrics,
) -> Result<(InversionDocument, [ContactSheet; 2]), EvalError> {
    evaluate_inversion(&evaluation(images, network, map, &Sift::default()), metrics, &())
}

fn evaluation<'a>(
    images: &[PathBuf],
    network: &'a InversionNetwork,
    map: Vec<KeypointImage>,
    extractor: &'a dyn Extractor,
) -> InversionEvaluation<'a> {
    InversionEvaluation {
        images: images.to_vec(),
        keypoints: Vec::new(),
        server: None,
        attack: AttackEvaluation {
            schemes: vec![Scheme::Points, Scheme::RandomLines, Scheme::default()],
            attacks: vec![Attack::CLOSED_FORM, Attack::GRAPH],
            k: 10,
            seed: 3,
            ..AttackEvaluation::default()
        },
        train: Vec::new(),
        map,
        network,
        extractor,
        limits: ExtractionLimits::default(),
        shown: 1,
    }
}

#[test]
fn document_has_rows_for_schemes_and_attacks() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let paths: Vec<PathBuf> = (0..6).map(|i| draw(folder.path(), 31 * i)).collect();
    let plain = network("learned/plain.toml");
    let limits = ExtractionLimits::default();
    let map = veiloc_datasets::problem_files::keypoints_of_images(&paths[5..], &Sift::default(), limits, &())
        .expect("images");
    let (document, sheets) = evaluate(&paths[3..5], &plain, map, &ImageMetrics::default()).expect("it runs");
    let names: Vec<String> =
        document.summary.iter().map(|row| format!("{} {}", row.scheme, row.attack)).collect();
    let dcl = Scheme::default().to_string();
    let expected = [
        "points none",
        "random-lines prior",
        "random-lines closed-form",
        "random-lines graph",
        "random-lines realistic",
        "random-lines lines",
        &format!("{dcl} prior"),
        &format!("{dcl} closed-form"),
        &format!("{dcl} graph"),
        &format!("{dcl} realistic"),
        &format!("{dcl} lines"),
        "unordered none",
        "none none",
    ];
    assert_eq!(names, expected);
    assert_eq!(document.rows.len(), 2 * expected.len());
    let row =
        |name: &str| -> &SummaryRow { &document.summary[names.iter().position(|n| n == name).expect(name)] };
    assert_eq!((row("points none").mean_px, row("points none").median_px), (Some(0.0), Some(0.0)));
    let graph = row("random-lines graph").mean_px.expect("places");
    assert!(graph > 0.0 && graph < row("random-lines prior").mean_px.expect("places"), "{graph}");
    assert_eq!(row("random-lines realistic").best_attack.as_deref(), Some("transfer"));
    for name in ["random-lines lines", "unordered none", "none none"] {
        assert_eq!((row(name).mean_px, row(name).median_px), (None, None));
    }
    for row in &document.rows {
        assert!(row.psnr > 0.0 && row.psnr < 60.0 && row.ssim < 1.0, "{row:?}");
        assert_eq!((row.st_lpips, row.top_1, row.objects), (None, None, None), "no metric was computed");
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
    let side = |sheet: &ContactSheet| sheet.rows[0][1].image.width();
    assert_eq!((side(&sheet), side(&wide)), (32, 64));
    assert!(sheet.png().expect("small").expect("tiles").starts_with(b"\x89PNG"));
    let table = evaluation_table(&document);
    assert!(table.contains("realistic (transfer)") && table.contains("Means over 2 images"), "{table}");

    assert!(document.summary.iter().all(|row| row.roc_auc.is_none()) && !table.contains("ROC AUC"));

    assert!(document.classes.is_none() && !document.network.has_visibility);

    // A repetition gives exactly the same result.
    let again = evaluate(&paths[3..5], &plain, Vec::new(), &ImageMetrics::default()).expect("it runs").0;
    let psnr = |d: &InversionDocument| d.rows.iter().find(|r| r.attack == "graph").map(|r| r.psnr);
    assert_eq!(psnr(&again), psnr(&document), "other attackers change nothing");
}

#[test]
fn visibility_output_is_evaluated_by_roc_auc() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let paths: Vec<PathBuf> = (3..5).map(|i| draw(folder.path(), 31 * i)).collect();
    let judging = network("learned/inversion.toml");
    let (document, _) = evaluate(&paths, &judging, Vec::new(), &ImageMetrics::default()).expect("it runs");
    assert!(document.network.has_visibility && document.network.file.ends_with("inversion.toml"));
    for row in &document.summary {
        // True keypoints are all correct, graph may recover all, and without positions there is no visibility.
        match (row.scheme.as_str(), row.attack) {
            ("points" | "none" | "unordered", _) | (_, "lines") => assert_eq!(row.roc_auc, None, "{row:?}"),
            (_, "prior" | "closed-form") => assert!(row.roc_auc.is_some(), "{row:?}"),
            _ => {}
        }
        assert!(row.roc_auc.is_none_or(|auc| auc > 0.0 && auc < 1.0), "{row:?}");
    }
    assert!(evaluation_table(&document).contains("ROC AUC"));
}

#[test]
fn image_metrics_are_computed() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let first = draw(folder.path(), 31);
    // The tiny classifier knows classes 10, 20 and 30, by colour; the synthetic images are brightest in blue.
    let named = folder.path().join("n01530575_brambling.png");
    std::fs::copy(&first, &named).expect("copied");
    let wrong = folder.path().join("n01440764_tench.png");
    std::fs::copy(&first, &wrong).expect("copied");
    let metrics = ImageMetrics {
        perceptual: Some(PerceptualDistance::open(&data("image_metrics/distance.onnx")).expect("a network")),
        classifier: Some(Classifier::open(&data("image_metrics/classifier.onnx")).expect("a network")),
        detector: None,
    };
    let plain = network("learned/plain.toml");
    let images = [first, named, wrong];
    let (document, _) = evaluate(&images, &plain, Vec::new(), &metrics).expect("it runs");
    let classes = document.classes.expect("classified");
    assert_eq!((classes.labelled, classes.pseudo_labelled), (2, 1));
    assert!(classes.labelled_top_1 <= classes.labelled_top_5 && classes.labelled_top_5 == 2, "{classes:?}");
    for row in &document.rows {
        let (first, five) = (row.top_1.expect("classified"), row.top_5.expect("classified"));
        // Of the five classes, three are the colours and the others 0 and 1.
        assert!(five && (!first || row.image != "n01440764_tench.png"), "{row:?}");
        assert!(row.st_lpips.is_some_and(|distance| distance > 0.0), "{row:?}");
    }
    for row in &document.summary {
        assert_eq!(row.top_5, Some(3), "{row:?}");
    }
    let table = evaluation_table(&document);
    assert!(
        table.contains("ST-LPIPS") && table.contains("2 images are named by their ImageNet synset"),
        "{table}"
    );
}

#[test]
fn features_must_match_the_network() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let paths = [draw(folder.path(), 31)];
    let plain = network("learned/plain.toml");
    let compact = Compact::default();
    let other = evaluation(&paths, &plain, Vec::new(), &compact);
    let refused =
        evaluate_inversion(&other, &ImageMetrics::default(), &()).expect_err("other features").to_string();
    assert!(refused.contains("plain.toml") && refused.contains("--features sift"), "{refused}");
}

/// Positions alone, and with the colour at each: networks that get no descriptor.
#[test]
fn networks_without_descriptors_get_positions_and_colours() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let paths = [draw(folder.path(), 31)];
    let of = |name: &str| {
        let (document, sheets) =
            evaluate(&paths, &network(name), Vec::new(), &ImageMetrics::default()).expect("it runs");
        let psnr = |scheme: &str| {
            document.summary.iter().find(|row| row.scheme == scheme).expect("a row of the table").psnr
        };
        ([psnr("points"), psnr("none")], sheets)
    };
    let ([points, none], [sheet, _]) = of("learned/colour.toml");
    assert!(points > none, "the colours of the keypoints are drawn: {points} {none}");
    // A cell without keypoints is gray; of the others each has the colour of a pixel that it covers.
    let [original, drawn] = [0, 1].map(|tile| sheet.rows[0][tile].image.data());
    let coloured = original.iter().zip(drawn).filter(|(_, own)| !(127..=128).contains(*own));
    let off = |from: &dyn Fn(u8) -> u8| -> u32 {
        coloured.clone().map(|(original, own)| u32::from(original.abs_diff(from(*own)))).sum()
    };
    let (own, gray) = (off(&|own| own), off(&|_| 128));
    assert!(coloured.clone().count() > 100 && 10 * own < 9 * gray, "{own} {gray}");
    let (_, [sheet, _]) = of("learned/places.toml");
    let is_gray = |pixel: &[u8]| pixel.iter().all(|value| *value == pixel[0]);
    let drawn = sheet.rows[0][1].image.data();
    assert!(
        drawn.chunks(3).all(is_gray) && drawn.iter().any(|value| *value > 100),
        "only where keypoints are"
    );
}
