//! Layers, keypoints and descriptors of XFeat compared with ONNX Runtime (`research/oracles/networks.py`); needs
//! `VEILOC_DATA`, and `weights/` beside it, provided by the user. Keypoints and descriptors of a synthetic ALIKED
//! compared with PyTorch and torchvision (`research/oracles/aliked.py`).

use super::common;

use std::path::Path;

use common::{drawn, engines, model, model_in, synthetic_alike, synthetic_aliked};
use serde_json::Value;
use veiloc_features::learned::{Engine, Layer, Learned, Tensor};
use veiloc_features::{Extractor, Image};
use veiloc_testdata::real_data_test;

const MARGIN: usize = 32;

/// A model with the margin of the oracle.
fn as_the_oracle(engine: Engine, data: &Path, name: &str) -> Learned {
    model_in(engine, &data.join("../weights"), name, &[("margin = 48", "margin = 32")])
}

fn oracle(name: &str) -> Value {
    let all: Value =
        serde_json::from_str(include_str!("../../data/learned/oracle.json")).expect("the oracle's document");
    all[name].clone()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("a list").iter().map(|v| v.as_f64().expect("a number")).collect()
}

fn size(oracle: &Value) -> [usize; 2] {
    let size = numbers(&oracle["size"]);
    [size[0] as usize, size[1] as usize]
}

/// The network's input, computed as in the oracle and independently of the crate.
fn input(size: [usize; 2], channels: usize, multiple: usize, normalized: bool) -> Tensor {
    let image = drawn(size[0] as u32, size[1] as u32);
    let mut samples: Vec<f64> = image.data().iter().map(|s| f64::from(*s)).collect();
    if normalized {
        let count = samples.len() as f64;
        let mean = samples.iter().sum::<f64>() / count;
        let variance = samples.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / count;
        samples = samples.iter().map(|s| (s - mean) / (variance + 1e-5).sqrt()).collect();
    }
    let whole = size.map(|side| (side + 2 * MARGIN).next_multiple_of(multiple));
    let first = [0, 1].map(|axis| (whole[axis] - size[axis]) / 2);
    let at = |at: usize, axis: usize| match at.checked_sub(first[axis]) {
        None => first[axis] - 1 - at,
        Some(inside) if inside < size[axis] => inside,
        Some(beyond) => 2 * size[axis] - 1 - beyond,
    };
    let mut data = Vec::new();
    for _ in 0..channels {
        for y in 0..whole[1] {
            data.extend((0..whole[0]).map(|x| samples[at(y, 1) * size[0] + at(x, 0)] as f32));
        }
    }
    Tensor { shape: vec![1, channels, whole[1], whole[0]], data }
}

/// The largest difference of any layer of the oracle, in its mean or in single values, relative to the largest value of
/// the layer. Shapes must be equal.
fn layers_off(learned: &Learned, oracle: &Value, input: &Tensor) -> f64 {
    let layers = oracle["layers"].as_object().expect("layers");
    assert!(layers.len() >= 10, "{} layers", layers.len());
    let names: Vec<Layer> = layers.keys().map(|name| Layer::from(name.as_str())).collect();
    let results = learned.network().run(input, &names).expect("it runs");
    let mut most: f64 = 0.0;
    for ((name, theirs), own) in layers.iter().zip(results) {
        let shape: Vec<usize> = numbers(&theirs["shape"]).iter().map(|side| *side as usize).collect();
        assert_eq!(own.shape, shape, "{name}");
        assert!(own.data.iter().all(|number| number.is_finite()), "{name}");
        let largest = theirs["largest"].as_f64().expect("a number");
        let mean = own.data.iter().map(|v| f64::from(*v)).sum::<f64>() / own.data.len() as f64;
        most = most.max((mean - theirs["mean"].as_f64().expect("a number")).abs() / largest);
        for (at, value) in numbers(&theirs["at"]).iter().zip(numbers(&theirs["values"])) {
            most = most.max((f64::from(own.data[*at as usize]) - value).abs() / largest);
        }
    }
    most
}

/// Rounding of single precision, in sums of a thousand products through ten layers.
const ROUNDING: f64 = 2e-5;

/// The oracle's strongest keypoints, each with its position, score and descriptor.
fn check_keypoints(learned: &Learned, oracle: &Value) {
    let size = size(oracle);
    let image = Image::from(drawn(size[0] as u32, size[1] as u32));
    let features = learned.extract(&image, 2048).expect("extracted");
    let kind = learned.kind();
    let (points, vectors) = (&oracle["keypoints"], &oracle["descriptors"]);
    let points: Vec<Vec<f64>> = points.as_array().expect("a list").iter().map(numbers).collect();
    assert!(points.len() >= 40 && features.keypoints.len() >= points.len(), "{}", features.keypoints.len());
    let step = (kind.dim() / 8).max(1);
    let mut found = 0;
    for (point, vector) in points.iter().zip(vectors.as_array().expect("a list")) {
        let near = features.keypoints.iter().position(|k| {
            (k.pixel.u - point[0]).hypot(k.pixel.v - point[1]) < 0.01
                && (f64::from(k.response) - point[2]).abs() < 1e-4 * point[2].max(0.01)
        });
        let Some(near) = near else { continue };
        let row = features.descriptors.row(near).iter().step_by(step);
        let off = row.zip(numbers(vector)).map(|(byte, number)| {
            (f64::from(kind.encoding().value(*byte)) - (number * f64::from(kind.norm())).clamp(-128.0, 127.0))
                .abs()
        });
        let off = off.fold(0.0, f64::max);
        // Half of it is the rounding to bytes.
        assert!(off < 0.55, "a descriptor is off by {off} of {}", kind.norm());
        found += 1;
    }
    // For two scores that differ only in the last bit, either may be larger.
    assert!(found * 100 >= points.len() * 97, "{found} of {} keypoints", points.len());
    let strongest = features.keypoints.windows(2).all(|pair| pair[0].response >= pair[1].response);
    assert!(strongest, "not in the order of strength");
}

/// A network in each engine. `channels` of the input, `multiple` of its sides, and whether it is normalized.
fn agrees_with_the_oracle(data: &Path, name: &str, channels: usize, multiple: usize, normalized: bool) {
    for engine in engines() {
        let (learned, oracle) = (as_the_oracle(engine, data, name), oracle(name));
        assert_eq!(learned.network().engine(), engine);
        let off = layers_off(&learned, &oracle, &input(size(&oracle), channels, multiple, normalized));
        assert!(off < ROUNDING, "{name}, {}: {off}", engine.name());
        check_keypoints(&learned, &oracle);
    }
}

#[real_data_test]
fn xfeat_agrees_with_onnx_runtime(data: &Path) {
    agrees_with_the_oracle(data, "xfeat", 1, 1, true);
}

/// Deformable convolutions and the head that samples at keypoints.
#[test]
fn aliked_agrees_with_torchvision() {
    let known: Value = serde_json::from_str(include_str!("../../data/learned/made-up-aliked.json"))
        .expect("the oracle's document");
    for engine in engines() {
        check_keypoints(&synthetic_aliked(engine), &known["made-up-aliked"]);
    }
}

/// The measure detects a slightly different input.
#[real_data_test]
fn different_input_gives_different_layers(data: &Path) {
    let (learned, oracle) = (as_the_oracle(Engine::Rten, data, "xfeat"), oracle("xfeat"));
    let mut input = input(size(&oracle), 1, 1, true);
    input.data = input.data.iter().map(|sample| sample * 1.01).collect();
    let off = layers_off(&learned, &oracle, &input);
    assert!(off > 10.0 * ROUNDING, "a hundredth brighter, and no layer differs: {off}");
}

/// One thread or several: the same bytes.
#[real_data_test]
fn features_are_independent_of_the_thread_count(data: &Path) {
    let image = Image::from(drawn(200, 150));
    check_thread_independence(&|| model(&data.join("../weights"), "xfeat"), &image);
}

/// The same for a network with one-channel convolutions, which need special treatment (`one_channel.rs`).
#[test]
fn features_of_a_synthetic_network_are_independent_of_the_thread_count() {
    check_thread_independence(&|| synthetic_alike(&[]), &Image::from(drawn(200, 150)));
    check_thread_independence(&|| synthetic_aliked(Engine::Rten), &Image::from(drawn(100, 75)));
}

fn check_thread_independence(open: &(dyn Fn() -> Learned + Sync), image: &Image) {
    let of = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| open().extract(image, 300).expect("extracted"))
    };
    let one = of(1);
    assert!(one.keypoints.len() > 20, "{}", one.keypoints.len());
    for threads in [2, 3, 7] {
        assert!(of(threads) == one, "{threads} threads");
    }
    // A single keypoint is a product with a vector.
    let single = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| open().extract(image, 1).expect("extracted"))
    };
    assert!(single(1) == single(3));
}
