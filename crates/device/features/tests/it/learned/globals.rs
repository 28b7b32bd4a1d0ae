//! Global descriptors of networks: compared with ONNX Runtime (`research/oracles/networks.py`), under masks, with any
//! number of threads, and with invalid descriptions.

use super::common;

use std::path::{Path, PathBuf};

use common::drawn;
use serde_json::Value;
use veiloc_features::FeatureError;
use veiloc_features::learned::{Engine, GlobalDescription, LearnedGlobal, Models};
use veiloc_features::{GlobalExtractor, GrayImage, Image, Mask};
use veiloc_testdata::real_data_test;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn data(name: &str) -> PathBuf {
    folder().join("tests/data/learned").join(name)
}

/// A built-in description with a replaced part.
fn described(name: &str, part: &str, by: &str) -> Result<GlobalDescription, FeatureError> {
    let text = std::fs::read_to_string(folder().join(format!("globals/{name}.toml"))).expect("a description");
    assert!(text.contains(part), "{part}");
    GlobalDescription::parse(&text.replace(part, by), Path::new("own.toml"))
}

/// The middle of a layer of corners: a network from an image to a vector.
fn corner_map() -> LearnedGlobal {
    let learned = Models::new(Vec::new()).open_global(data("corner-map.toml").to_str().expect("text"));
    learned.expect("a network beside its description")
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("a list").iter().map(|v| v.as_f64().expect("a number")).collect()
}

#[test]
fn one_file_is_needed_for_each_network() {
    let description = described("netvlad", "", "").expect("a description");
    let text = LearnedGlobal::open(description, &[], Engine::Rten).expect_err("no file").to_string();
    assert!(text.contains("0 files were given for 1 networks"), "{text}");
}

#[test]
fn codes_are_independent_of_the_thread_count() {
    let image = Image::from(drawn(100, 84));
    let of = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| corner_map().describe(&image).expect("described"))
    };
    let one = of(1);
    assert!(one.as_codes().iter().any(|code| *code > 5), "not all codes are zero");
    for threads in [2, 3, 7] {
        assert_eq!(of(threads), one, "{threads} threads");
    }
}

/// Pixels under a mask have no influence on the vector; others have.
#[test]
fn l14_hidden_pixels_have_no_influence_on_codes() {
    let learned = corner_map();
    let hides = |x: u32, y: u32| (40..80).contains(&x) && (20..60).contains(&y);
    let mask = Mask::new(100, 84, hides).expect("a part");
    let plain = drawn(100, 84);
    let other = |is_changed: &dyn Fn(u32, u32) -> bool| {
        let samples = plain.data().iter().enumerate();
        let samples =
            samples.map(
                |(i, sample)| {
                    if is_changed(i as u32 % 100, i as u32 / 100) { 1.0 - sample } else { *sample }
                },
            );
        GrayImage::new(100, 84, samples.collect()).expect("whole rows")
    };
    let masked = |image: GrayImage| {
        let image = Image::from(image).without(&mask).expect("of its size");
        learned.describe(&image).expect("described")
    };
    let beneath = other(&hides);
    assert_eq!(masked(plain.clone()), masked(beneath.clone()));
    let unmasked = |image: GrayImage| learned.describe(&Image::from(image)).expect("described");
    assert_ne!(unmasked(plain.clone()), unmasked(beneath), "without the mask the measure sees the change");
    let beside = other(&|x, y| x < 30 && y < 30);
    assert_ne!(masked(plain), masked(beside), "pixels beside the mask have influence");
}

#[test]
fn invalid_description_is_rejected_with_its_fault() {
    for (name, part, by, expected) in [
        ("netvlad", "numbers = 4096", "numbers = 20000", "global dim"),
        ("netvlad", "name = \"netvlad\"", "name = \"vlad\"", "vlad"),
        ("netvlad", "channels = 3", "channels = 2", "1 or 3"),
        ("netvlad", "longest_side = 1024", "longest_side = 10", "longest_side"),
        ("netvlad", "longest_side = 1024", "size = [10, 640]", "size"),
        ("netvlad", "longest_side = 1024", "longest = 1024", "unknown field"),
        ("netvlad", "[networks.image]", "inputs = [\"before\"]\n[networks.image]", "inputs"),
        ("xfeat-netvlad", "[\"before\", \"image\"]", "[\"image\", \"image\"]", "each once"),
        ("xfeat-netvlad", "[\"before\", \"image\"]", "[\"before\"]", "networks.image"),
        ("xfeat-netvlad", "channels_last = true", "graph = \"netvlad\"", "unknown field"),
        ("xfeat-netvlad", "middle = [80, 60]", "middle = [80, 0]", "middle"),
        ("xfeat-netvlad", "files = [\"netvlad.onnx\"]", "files = [\"../netvlad.onnx\"]", "without folders"),
    ] {
        let refused = described(name, part, by).expect_err(by);
        assert!(matches!(refused, FeatureError::Description { .. }), "{by}: {refused}");
        let text = refused.to_string();
        assert!(text.contains(expected) && text.starts_with("own.toml"), "{by}: {text}");
    }
}

#[test]
fn error_of_a_missing_file_has_its_source() {
    let folder = tempfile::tempdir().expect("a folder");
    let models = Models::new(vec![folder.path().to_owned()]);
    let found: Vec<(String, usize)> = models
        .globals()
        .map(|found| (found.description.name().to_owned(), found.files.iter().flatten().count()))
        .collect();
    assert_eq!(found, [("netvlad".to_owned(), 0), ("xfeat-netvlad".to_owned(), 0)]);
    let text = models.open_global("netvlad").expect_err("no file").to_string();
    for part in ["VGG16-NetVLAD-Pitts30K.onnx", "cvg-data.inf.ethz.ch", "VEILOC_MODELS"] {
        assert!(text.contains(part), "{text}");
    }
    let text = models.open_global("gem").expect_err("unknown").to_string();
    assert!(text.contains("\"gem\"") && text.contains("vlad, netvlad, xfeat-netvlad"), "{text}");
    // Networks that do not match their description.
    std::fs::write(folder.path().join("netvlad.onnx"), "no network").expect("written");
    std::fs::copy(data("two-boxes.onnx"), folder.path().join("xfeat_640x640.onnx")).expect("copied");
    std::fs::copy(data("two-boxes.onnx"), folder.path().join("xfeat_nv.onnx")).expect("copied");
    assert!(matches!(models.open_global("xfeat-netvlad"), Err(FeatureError::Network { .. })));
    std::fs::copy(data("two-boxes.onnx"), folder.path().join("netvlad.onnx")).expect("copied");
    assert!(models.globals().nth(1).expect("xfeat-netvlad").files.iter().all(Option::is_some));
    let text = models.open_global("xfeat-netvlad").expect_err("one input").to_string();
    assert!(text.contains("has 1 inputs instead of 2"), "{text}");
}

/// Any network from an image to a vector can be described: here the middle of a layer.
#[test]
fn own_network_needs_only_a_description() {
    let learned = corner_map();
    let codes = learned.describe(&Image::from(drawn(128, 96))).expect("described");
    assert_eq!((codes.len(), learned.model().name()), (720, "corner-map"));
    assert!(codes.as_codes().iter().any(|code| *code != 0));
    let flat = Image::from(GrayImage::new(64, 48, vec![0.5; 64 * 48]).expect("whole rows"));
    assert!(learned.describe(&flat).expect("described").as_codes().iter().all(|code| *code == 0));
}

/// XFeat's three networks, compared with the same files in ONNX Runtime with an input made by NumPy.
#[real_data_test]
fn xfeat_netvlad_agrees_with_onnx_runtime(data: &Path) {
    let models = Models::new(vec![data.join("../weights")]);
    let learned = models.open_global("xfeat-netvlad").expect("files beside the data");
    let oracle: Value =
        serde_json::from_str(include_str!("../../data/learned/xfeat-netvlad.json")).expect("a document");
    let vector = learned.vector(&drawn(640, 480)).expect("described");
    assert_eq!(vector.len(), 16_384);
    let (at, values) = (numbers(&oracle["at"]), numbers(&oracle["values"]));
    let largest = oracle["largest"].as_f64().expect("a number");
    assert!(at.len() >= 40);
    let off = at.iter().zip(&values).map(|(at, value)| (f64::from(vector[*at as usize]) - value).abs());
    let off = off.fold(0.0, f64::max);
    assert!(off < 1e-3 * largest, "{off} of {largest}");
}
