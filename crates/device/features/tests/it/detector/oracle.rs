//! The boxes of a real detector file against those of another runtime (`research/oracles/detector.py`). Needs
//! `VEILOC_DATA`, and beside it `weights/yolo/yolo11n_int8.onnx`, provided by the user.

use std::path::Path;

use serde_json::Value;
use veiloc_features::detector::{Detection, Detector, HideOptions, ObjectMasker};
use veiloc_features::load_colour;
use veiloc_testdata::real_data_test;

fn overlap(a: [f32; 4], b: &[f64]) -> f64 {
    let a = a.map(f64::from);
    let side = |low: f64, high: f64| (high - low).max(0.0);
    let shared = side(a[0].max(b[0]), a[2].min(b[2])) * side(a[1].max(b[1]), a[3].min(b[3]));
    shared / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - shared)
}

/// JPEG decoders differ by a gray level here and there, and a quantized network rounds its values: scores differ by at
/// most 0.10, overlaps are at least 0.89. With rten's own `ConvInteger` (`features/src/learned/onnx/exact.rs`) scores
/// differ by 0.27, and two trains are not found.
#[real_data_test]
fn boxes_agree_with_onnx_runtime(data: &Path) {
    let weights = data.join("../weights/yolo/yolo11n_int8.onnx");
    let detector = Detector::open(&weights).expect("a detector beside the data");
    let oracle: Value =
        serde_json::from_str(include_str!("../../data/detector/oracle.json")).expect("the oracle's document");
    let names: Vec<&str> =
        oracle["names"].as_array().expect("a list").iter().map(|n| n.as_str().expect("text")).collect();
    assert_eq!(detector.names(), names);
    let mut compared = 0;
    for (photo, theirs) in oracle["photos"].as_object().expect("photographs") {
        let image = load_colour(&data.join("photos").join(photo)).expect("a photograph");
        // Slightly below the oracle's minimum score: a score near it may fall on either side.
        let ours = detector.detect(&image, 0.2).expect("it runs");
        for their in theirs.as_array().expect("boxes") {
            let corners: Vec<f64> = their["corners"]
                .as_array()
                .expect("four")
                .iter()
                .map(|c| c.as_f64().expect("a number"))
                .collect();
            let score = their["score"].as_f64().expect("a score");
            let like = |d: &&Detection| {
                their["class"] == d.class
                    && overlap(d.corners, &corners) > 0.85
                    && (f64::from(d.score) - score).abs() < 0.12
            };
            assert!(ours.iter().any(|d| like(&d)), "{photo}: {their} is not among {} boxes", ours.len());
            compared += 1;
        }
        let sure = ours.iter().filter(|d| d.score > 0.3).count();
        assert!(
            sure <= theirs.as_array().expect("boxes").len(),
            "{photo}: {sure} boxes that the oracle lacks"
        );
    }
    assert!(compared >= 8, "{compared}");
}

#[real_data_test]
fn people_of_a_photograph_are_hidden(data: &Path) {
    let weights = data.join("../weights/yolo/yolo11n_int8.onnx");
    let masker =
        ObjectMasker::open(&weights, &["person".to_owned()], HideOptions::default()).expect("a detector");
    let hidden = masker.hide(&data.join("photos/24.jpg")).expect("it runs");
    let [(name, count)] = &hidden.found[..] else { panic!("{:?}", hidden.found) };
    let mask = hidden.mask.expect("there are people");
    assert!(name == "person" && *count >= 1, "{count}");
    assert!((0.005..0.5).contains(&mask.share()), "{}", mask.share());
}
