//! Engines: by name, and the error for an unavailable one.

use super::common;

use std::path::Path;

use common::{drawn, engines};
use veiloc_features::FeatureError;
use veiloc_features::learned::{Engine, Models};
use veiloc_features::{Extractor, Image};
use veiloc_testdata::real_data_test;

#[test]
fn engines_are_known_by_name() {
    for engine in Engine::ALL {
        assert_eq!(engine.name().parse::<Engine>().ok(), Some(engine));
    }
    let error = "tensorflow".parse::<Engine>().unwrap_err().to_string();
    assert_eq!(error, "unknown engine \"tensorflow\"; known: rten, onnxruntime");
}

/// An unavailable engine is reported and not replaced by rten.
#[real_data_test]
fn unavailable_engine_is_an_error(data: &Path) {
    if engines().contains(&Engine::OnnxRuntime) {
        return;
    }
    let file = data.join("../weights/xfeat/xfeat_640x640.onnx");
    let models = Models::new(Vec::new()).with_engine(Engine::OnnxRuntime);
    let error = models.open("xfeat", Some(&file)).unwrap_err();
    let expected = if cfg!(feature = "onnxruntime") {
        "ORT_DYLIB_PATH names no library"
    } else {
        "this program was built without ONNX Runtime"
    };
    assert!(matches!(&error, FeatureError::Network { reason, .. } if reason.contains(expected)), "{error}");
}

/// A file that is not a network is an error in every engine, and so is an image of the wrong size.
#[test]
fn invalid_network_is_an_error_in_every_engine() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("xfeat_640x640.onnx");
    for bytes in [&b""[..], b"not a network", &[8, 8, 58, 2, 10]] {
        std::fs::write(&file, bytes).expect("written");
        for engine in engines() {
            let opened = Models::new(Vec::new()).with_engine(engine).open("xfeat", Some(&file));
            assert!(matches!(opened, Err(FeatureError::Network { .. })), "{}: {opened:?}", engine.name());
        }
    }
}

/// Engines differ only by rounding: most keypoints are the same, to a hundredth of a pixel.
#[real_data_test]
fn engines_agree(data: &Path) {
    let image = Image::from(drawn(300, 200));
    for (name, file) in [("xfeat", "xfeat/xfeat_640x640.onnx")] {
        let of = |engine: Engine| {
            let models = Models::new(Vec::new()).with_engine(engine);
            let learned = models.open(name, Some(&data.join("../weights").join(file))).expect("a network");
            learned.extract(&image, 300).expect("extracted").keypoints
        };
        let first = of(Engine::Rten);
        assert!(first.len() > 50, "{name}: {}", first.len());
        for engine in engines() {
            let found = of(engine);
            let same = first.iter().filter(|one| found.iter().any(|k| one.pixel.distance(&k.pixel) < 0.01));
            let same = same.count();
            assert!(same * 100 >= first.len() * 97, "{name}, {}: {same} of {}", engine.name(), first.len());
        }
    }
}
