//! Detector files, invalid ones and one valid one; `research/oracles/detector.py` makes them.

use std::path::PathBuf;

use veiloc_features::ColourImage;
use veiloc_features::FeatureError;
use veiloc_features::detector::{Detector, HideOptions, ObjectMasker};

fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/detector").join(name)
}

fn image(width: u32, height: u32) -> ColourImage {
    ColourImage::new(width, height, vec![90; (width * height * 3) as usize]).expect("whole rows")
}

#[test]
fn boxes_are_in_pixels_of_the_file() {
    let detector = Detector::open(&file("two-boxes.onnx")).expect("a detector");
    assert_eq!(detector.names(), ["person", "car"]);
    // 64 x 64 contains the image in rows 16 to 48, at half size.
    let found = detector.detect(&image(128, 64), 0.25).expect("it runs");
    let boxes: Vec<(usize, [f32; 4])> = found.iter().map(|d| (d.class, d.corners)).collect();
    assert_eq!(boxes, [(0, [20.0, -8.0, 44.0, 72.0]), (1, [76.0, 22.0, 116.0, 42.0])]);
    assert_eq!(
        detector.detect(&image(128, 64), 0.7).expect("it runs").len(),
        1,
        "the one with the higher score"
    );
    assert!(!format!("{found:?}{detector:?}").contains("20"), "L8: no positions");
}

#[test]
fn invalid_detector_files_are_rejected() {
    let folder = tempfile::tempdir().expect("a folder");
    let whole = std::fs::read(file("two-boxes.onnx")).expect("a detector");
    let cut = folder.path().join("cut.onnx");
    std::fs::write(&cut, &whole[..whole.len() / 2]).expect("written");
    let (empty, text) = (folder.path().join("empty.onnx"), folder.path().join("text.onnx"));
    std::fs::write(&empty, []).expect("written");
    std::fs::write(&text, "no model").expect("written");
    for (path, part) in [
        (cut, "cannot be used"),
        (empty, "cannot be used"),
        (text, "cannot be used"),
        (file("no-names.onnx"), "names of its classes"),
        (file("any-size.onnx"), "fixed size"),
    ] {
        let refused = Detector::open(&path).expect_err("refused");
        assert!(matches!(refused, FeatureError::Detector { .. }), "{}: {refused}", path.display());
        assert!(refused.to_string().contains(part), "{}: {refused}", path.display());
    }
    let gone = Detector::open(&folder.path().join("gone.onnx"));
    assert!(matches!(gone, Err(FeatureError::ReadDetector { .. })), "{gone:?}");
    // Their format is checked only when they run; NaN must not be treated as no detection.
    for (name, part) in [("three-names.onnx", "instead of 7"), ("not-a-number.onnx", "NaN or infinity")] {
        let refused =
            Detector::open(&file(name)).expect("opened").detect(&image(64, 64), 0.25).expect_err("refused");
        assert!(
            matches!(refused, FeatureError::DetectorRun { .. }) && refused.to_string().contains(part),
            "{refused}"
        );
    }
}

#[test]
fn class_names_come_from_the_file() {
    let open = |classes: &[&str]| {
        let classes: Vec<String> = classes.iter().map(|c| (*c).to_owned()).collect();
        ObjectMasker::open(&file("two-boxes.onnx"), &classes, HideOptions::default())
    };
    let refused = open(&["person", "dog"]).expect_err("unknown");
    assert_eq!(refused.to_string(), "the detector has no class dog; its classes: person, car");
    assert!(matches!(open(&[]), Err(FeatureError::NoClass { .. })));
    open(&["car"]).expect("a class");
}
