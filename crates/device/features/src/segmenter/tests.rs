//! The networks against LiteRT (`research/oracles/segmenter.py`). MediaPipe's files are the user's: `VEILOC_DATA`, and beside
//! it `weights/mediapipe`.

use std::path::Path;

use serde_json::Value;
use veiloc_geometry::QuarterTurns;
use veiloc_testdata::real_data_test;

use super::PersonSegmenter;
use crate::{ColourImage, FeatureError, load_colour};

const TINY: &[u8] = include_bytes!("../../tests/data/segmenter/tiny.tflite");

fn oracle(name: &str) -> Vec<f32> {
    let all: Value =
        serde_json::from_str(include_str!("../../tests/data/segmenter/oracle.json")).expect("a document");
    all[name].as_array().expect("a list").iter().map(|v| v.as_f64().expect("a number") as f32).collect()
}

/// The oracle's drawing at a position of `[0, 1] x [0, 1]`, less its shade.
fn drawing([u, v]: [f64; 2]) -> [f64; 3] {
    let square = |x: f64| x * x;
    let inside =
        |at: [f64; 2], half: [f64; 2]| square((u - at[0]) / half[0]) + square((v - at[1]) / half[1]) < 1.0;
    let (head, body) = (inside([0.5, 0.35], [0.13, 0.2]), inside([0.5, 1.0], [0.35, 0.45]));
    [0.0, 1.0, 2.0].map(|channel| match (head, body) {
        (true, _) => 0.75 - 0.15 * channel,
        (false, true) => 0.1 + 0.15 * channel,
        (false, false) => 0.6,
    })
}

fn open(data: &Path, name: &str) -> PersonSegmenter {
    let file =
        std::fs::read(data.join("../weights/mediapipe").join(name)).expect("a network beside the data");
    PersonSegmenter::read(&file).expect("a segmenter")
}

/// The outputs at every `step`-th row and column are the oracle's.
fn agrees(segmenter: &PersonSegmenter, name: &str, step: usize) {
    let [height, width, _] = segmenter.0.input;
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (y, x)));
    let image = pixels.flat_map(|(y, x)| {
        let shade = ((x * 5 + y * 3) % 16) as f64 / 64.0;
        drawing([x as f64 / width as f64, y as f64 / height as f64]).map(|shown| (shown + shade) as f32)
    });
    let output = segmenter.0.run(image.collect());
    let ours = (0..height).step_by(step).flat_map(|y| (0..width).step_by(step).map(move |x| y * width + x));
    let (ours, theirs): (Vec<f32>, _) = (ours.map(|at| output[at]).collect(), oracle(name));
    assert_eq!(ours.len(), theirs.len());
    let off = ours.iter().zip(&theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(off < 2e-4, "{name}: {off}");
}

#[test]
fn operators_agree_with_litert() {
    agrees(&PersonSegmenter::read(TINY).expect("a segmenter"), "tiny.tflite", 3);
}

#[real_data_test]
fn official_files_agree_with_litert(data: &Path) {
    for name in ["selfie_segmentation.tflite", "selfie_segmentation_landscape.tflite"] {
        agrees(&open(data, name), name, 15);
    }
}

#[real_data_test]
fn people_of_photographs_agree_with_litert(data: &Path) {
    let segmenter = open(data, "selfie_segmentation.tflite");
    for name in ["photos/29.jpg", "training-photos/nature/388016.jpg"] {
        let image = load_colour(&data.join(name)).expect("a photograph");
        let channels = image.channels().map(|channel| channel.resized(256, 256));
        let output = segmenter.0.run(segmenter.part(&channels, [0, 0]));
        let theirs = oracle(name);
        for (cell, their) in theirs.iter().enumerate() {
            let rows = (cell / 16 * 16)..(cell / 16 * 16 + 16);
            let sum: f32 = rows.map(|y| output[y * 256 + cell % 16 * 16..][..16].iter().sum::<f32>()).sum();
            // Decoders of JPEG differ by some gray levels at edges of colours.
            assert!((sum / 256.0 - their).abs() < 0.06, "{name} {cell}: {} {their}", sum / 256.0);
        }
        let most = theirs.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).expect("cells").0 as u32;
        let mask = segmenter.mask(&image, QuarterTurns::NONE, 0.02).expect("a mask").expect("people");
        let at = |cell: u32, side: u32| (2 * cell + 1) * side / 32;
        assert!(mask.hides(at(most % 16, image.width()), at(most / 16, image.height())), "{name}");
    }
}

/// A photograph of a person, small in each corner of a gray image: in the whole image the network sees nobody.
#[real_data_test]
fn small_people_are_hidden_where_they_are(data: &Path) {
    let segmenter = open(data, "selfie_segmentation.tflite");
    let photo = load_colour(&data.join("training-photos/nature/146074.jpg")).expect("a photograph");
    let small = photo.channels().map(|channel| channel.resized(256, 192));
    for corner in [[0, 0], [384, 0], [0, 288], [384, 288]] {
        let pixels = (0..480_u32).flat_map(|y| (0..640_u32).map(move |x| [x, y]));
        let shown = pixels.flat_map(|[x, y]| match [x.wrapping_sub(corner[0]), y.wrapping_sub(corner[1])] {
            [x @ 0..256, y @ 0..192] => {
                small.each_ref().map(|channel| (channel.row(y)[x as usize] * 255.0) as u8)
            }
            _ => [128; 3],
        });
        let image = ColourImage::new(640, 480, shown.collect()).expect("whole rows");
        let channels = image.channels().map(|channel| channel.resized(256, 256));
        let whole = segmenter.0.run(segmenter.part(&channels, [0, 0]));
        let mask = segmenter.mask(&image, QuarterTurns::NONE, 0.02).expect("a mask").expect("a person");
        // The person's middle in the photograph.
        let [x, y] = [corner[0] + 207, corner[1] + 113];
        assert!(
            whole[(y * 256 / 480 * 256 + x * 256 / 640) as usize] < 0.1,
            "{corner:?}: found in the whole image"
        );
        assert!(mask.hides(x, y) && !mask.hides(640 - x, 480 - y), "{corner:?}: {}", mask.share());
        assert!(mask.share() < 0.1, "{}", mask.share());
    }
}

#[test]
fn a_network_that_marks_everything_is_an_error() {
    let segmenter = PersonSegmenter::read(TINY).expect("a segmenter");
    let image = ColourImage::new(40, 30, vec![90; 40 * 30 * 3]).expect("whole rows");
    assert!(matches!(segmenter.mask(&image, QuarterTurns::NONE, 0.02), Err(FeatureError::HidesAll { .. })));
    assert!(matches!(
        segmenter.mask(&image, QuarterTurns::NONE, f32::NAN),
        Err(FeatureError::MaskMargin { .. })
    ));
    assert_eq!(segmenter.confidence(&image).expect("it runs").1, (80, 80));
}

/// Files that are cut, and files with wrong bytes, give an error or a network that runs.
#[test]
fn damaged_files_are_errors() {
    for length in 0..TINY.len() {
        assert!(PersonSegmenter::read(&TINY[..length]).is_err(), "{length}");
    }
    let (mut refused, mut ran) = (0, 0);
    for at in 0..TINY.len() {
        for change in [0xff, 0x80, 1] {
            let mut file = TINY.to_vec();
            file[at] ^= change;
            match PersonSegmenter::read(&file) {
                Err(FeatureError::Segmenter { .. }) => refused += 1,
                Err(other) => panic!("{other}"),
                Ok(segmenter) => {
                    let [height, width, _] = segmenter.0.input;
                    assert_eq!(segmenter.0.run(vec![0.5; height * width * 3]).len(), height * width);
                    ran += 1;
                }
            }
        }
    }
    assert!(refused > 1000 && ran > 1000, "{refused} {ran}");
    let other = PersonSegmenter::read(b"no model").expect_err("refused").to_string();
    assert!(
        other.contains("it is not a TFLite file") && other.contains("selfie_segmentation.tflite"),
        "{other}"
    );
}
