//! The synthetic image of the oracles, a synthetic network, and the real one beside the real images.
#![allow(dead_code)] // each test binary uses its own part

use std::path::{Path, PathBuf};

use veiloc_features::learned::{Description, Engine, Learned};
use veiloc_features::{Extractor, GrayImage, Image};

/// Blocks with noise, with integer values.
pub(crate) fn drawn(width: u32, height: u32) -> GrayImage {
    let sample = |x: u32, y: u32| {
        let (a, b) = (x / 11, y / 13);
        let block = (a * 7 + b * 11 + (a ^ b) * 37) % 160;
        (block + (x * 7 + y * 13 + x * y) % 31 + x % 50) as f32 / 255.0
    };
    let samples = (0..width * height).map(|i| sample(i % width, i / width));
    GrayImage::new(width, height, samples.collect()).expect("whole rows")
}

pub(crate) fn models_folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("models")
}

/// A built-in description with replaced parts.
fn described(name: &str, changes: &[(&str, &str)]) -> Description {
    described_in(&models_folder().join(format!("{name}.toml")), name, changes)
}

/// The same, as if it were in another file.
fn described_in(file: &Path, name: &str, changes: &[(&str, &str)]) -> Description {
    let own = models_folder().join(format!("{name}.toml"));
    let mut text = std::fs::read_to_string(own).expect("a description");
    for (part, by) in changes {
        assert!(text.contains(part), "{part}");
        text = text.replace(part, by);
    }
    Description::parse(&text, file).expect("a description")
}

/// The engines of this build: ONNX Runtime only with its cargo feature and `ORT_DYLIB_PATH`.
pub(crate) fn engines() -> Vec<Engine> {
    let runtime = cfg!(feature = "onnxruntime") && std::env::var_os("ORT_DYLIB_PATH").is_some();
    [Engine::Rten].into_iter().chain(runtime.then_some(Engine::OnnxRuntime)).collect()
}

/// One of the models, with its file from the folder of weights.
pub(crate) fn model(weights: &Path, name: &str) -> Learned {
    model_in(Engine::Rten, weights, name, &[])
}

/// The same in an engine, with replaced parts of its description.
pub(crate) fn model_in(engine: Engine, weights: &Path, name: &str, changes: &[(&str, &str)]) -> Learned {
    let file = weights.join("xfeat/xfeat_800x576.onnx");
    Learned::open(described(name, changes), &file, engine).expect("a file beside the data")
}

/// The synthetic ALIKE with its 16 numbers projected to 48 of 4 bits (a real network has more than 16, and rows of so
/// few coarse numbers are often equal): signs from a formula, minus the mean of the synthetic image's descriptors, in
/// steps of 0.4 deviations.
pub(crate) fn synthetic_compact() -> Learned {
    let folder = tempfile::tempdir().expect("a folder");
    let features = synthetic_alike(&[]).extract(&Image::from(drawn(320, 240)), 600).expect("extracted");
    let sign =
        |i: usize, j: usize| if (i * 16 + j).wrapping_mul(0x9e37_79b9) >> 19 & 1 == 0 { 1.0 } else { -1.0 };
    let count = features.descriptors.len() as f64;
    let (mut weights, mut offsets) = (Vec::new(), Vec::new());
    for i in 0..48 {
        let sum = |row| -> f64 {
            let values = features.descriptors.view().values(row).enumerate();
            values.map(|(j, x)| sign(i, j) * f64::from(x)).sum()
        };
        let mean = (0..features.descriptors.len()).map(sum).sum::<f64>() / count;
        let variance =
            (0..features.descriptors.len()).map(|row| (sum(row) - mean).powi(2)).sum::<f64>() / count;
        let weight = (65536.0 / (0.4 * variance.sqrt())).min(30_000.0);
        weights.extend((0..16).flat_map(|j| ((weight * sign(i, j)) as i16).to_le_bytes()));
        offsets.extend(((-weight * mean) as i32).to_le_bytes());
    }
    std::fs::write(folder.path().join("signs.bin"), [weights, offsets].concat()).expect("written");
    let projection =
        "receptive_field = 32\n[projection]\nfile = \"signs.bin\"\nnumbers = 48\nshift = 16\nlength = 275\n";
    let changes = [("\"made-up\"", "\"made-up-compact\""), ("receptive_field = 32", projection)];
    synthetic_alike_in(&folder.path().join("own.toml"), &changes)
}

/// A network of ALIKE's architecture with few channels and weights from a formula (`research/oracles/tiny_networks.py`), for
/// tests that need no real network.
pub(crate) fn synthetic_alike(changes: &[(&str, &str)]) -> Learned {
    synthetic_alike_in(&models_folder().join("alike.toml"), changes)
}

/// A network of ALIKED's architecture, with its head (`research/oracles/aliked.py`).
pub(crate) fn synthetic_aliked(engine: Engine) -> Learned {
    let own = [
        ("name = \"aliked-n16\"", "name = \"made-up\""),
        ("head = \"aliked-n16-head.onnx\"", "head = \"made-up-aliked-head.onnx\""),
        ("numbers = 128", "numbers = 8"),
        ("length = 362", "length = 91"),
    ];
    let network = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/learned/made-up-aliked.onnx");
    Learned::open(described("aliked-n16", &own), &network, engine).expect("a network and its head")
}

/// The synthetic ALIKE, with files of its description searched beside this one.
fn synthetic_alike_in(file: &Path, changes: &[(&str, &str)]) -> Learned {
    let own = [
        ("name = \"alike\"", "name = \"made-up\""),
        ("numbers = 128", "numbers = 16"),
        ("length = 362", "length = 128"),
    ];
    let description = described_in(file, "alike", &[&own[..], changes].concat());
    let network = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/learned/made-up.onnx");
    Learned::open(description, &network, Engine::Rten).expect("a network")
}
