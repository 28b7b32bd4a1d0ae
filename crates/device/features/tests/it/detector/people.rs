//! People of a segmenter, hidden in image files. `red.tflite` takes what is red for people (`research/oracles/segmenter.py`).

use std::path::{Path, PathBuf};

use image::{DynamicImage, Rgb, RgbImage};
use veiloc_features::detector::{HideOptions, ObjectMasker};
use veiloc_features::{FeatureError, display_turn, exif_turns_of};
use veiloc_testing::exif::{self, Field::Short, ORIENTATION};

fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/segmenter").join(name)
}

fn masker(path: &Path, class: &str) -> Result<ObjectMasker, FeatureError> {
    ObjectMasker::open(path, &[class.to_owned()], HideOptions::default())
}

/// Blue, with red in columns 40 to 60 and rows 20 to 30, and in the pixels that `also` says.
fn drawn(size: (u32, u32), also: impl Fn(u32, u32) -> bool) -> DynamicImage {
    let red = |x, y| ((40..60).contains(&x) && (20..30).contains(&y)) || also(x, y);
    RgbImage::from_fn(size.0, size.1, |x, y| Rgb(if red(x, y) { [250, 10, 20] } else { [20, 30, 120] }))
        .into()
}

#[test]
fn people_are_hidden_in_the_stored_pixels_of_turned_images() {
    let masker = masker(&file("red.tflite"), "people").expect("a segmenter");
    let folder = tempfile::tempdir().expect("a folder");
    for orientation in 1..=8 {
        let path = folder.path().join(format!("{orientation}.png"));
        let metadata = exif::tiff(&[Short(ORIENTATION, orientation)], &[]);
        exif::save(&path, &drawn((160, 120), |_, _| false), Some(metadata));
        let hidden = masker.hide(&path).expect("it runs");
        assert_eq!(hidden.found, [("people".to_owned(), 1)], "{orientation}");
        let mask = hidden.mask.expect("people");
        let bytes = std::fs::read(&path).expect("a file");
        let turn = display_turn(&path).map_or(0, |turn| turn.degrees);
        assert_eq!(exif_turns_of(&bytes).degrees(), turn, "{orientation}");
        // The margin is 0.02 of the sides, and pixels of the network are 2 wide.
        for y in 0..120 {
            for x in 0..160 {
                let inside = (40..60).contains(&x) && (20..30).contains(&y);
                let near = (30..70).contains(&x) && (12..38).contains(&y);
                assert!(mask.hides(x, y) || !inside, "{orientation}: {x} {y} is sent");
                assert!(!mask.hides(x, y) || near, "{orientation}: {x} {y} is hidden");
            }
        }
    }
}

#[test]
fn regions_and_their_absence_are_reported() {
    let masker = masker(&file("red.tflite"), "people").expect("a segmenter");
    let folder = tempfile::tempdir().expect("a folder");
    let hide = |image: &DynamicImage| {
        let path = folder.path().join("a.png");
        image.save(&path).expect("written");
        masker.hide(&path)
    };
    let two = hide(&drawn((160, 120), |x, y| x > 130 && y > 90)).expect("it runs");
    assert_eq!(two.found, [("people".to_owned(), 2)]);
    // The red part lies outside of this image.
    let none = hide(&drawn((39, 19), |_, _| false)).expect("it runs");
    assert_eq!((none.found, none.mask), (vec![("people".to_owned(), 0)], None));
    let all = hide(&drawn((64, 48), |_, _| true)).expect_err("all is red");
    assert!(matches!(all, FeatureError::HidesAll { .. }), "{all}");
}

#[test]
fn other_files_and_classes_are_rejected() {
    let refused = masker(&file("red.tflite"), "person").expect_err("another class");
    assert_eq!(refused.to_string(), "the detector has no class person; its classes: people");
    let folder = tempfile::tempdir().expect("a folder");
    let (cut, large) = (folder.path().join("cut.tflite"), folder.path().join("large.tflite"));
    let whole = std::fs::read(file("tiny.tflite")).expect("a network");
    std::fs::write(&cut, &whole[..whole.len() / 2]).expect("written");
    let mut bytes = whole;
    bytes.resize((16 << 20) + 1, 0);
    std::fs::write(&large, bytes).expect("written");
    for (path, part) in [(cut, "it is damaged; give"), (large, "it has more than 16777216 bytes")] {
        let refused = masker(&path, "people").expect_err("refused");
        let text = refused.to_string();
        assert!(matches!(refused, FeatureError::Detector { .. }) && text.contains(part), "{text}");
    }
    let gone = masker(&folder.path().join("gone.tflite"), "people");
    assert!(matches!(gone, Err(FeatureError::ReadDetector { .. })), "{gone:?}");
}
