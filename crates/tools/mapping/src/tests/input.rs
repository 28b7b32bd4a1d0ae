//! Tests of bad input: each error names the problem and the remedy.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::colmap::ColmapModel;
use veiloc_map::{BuildSettings, MapError, PosedImage, PosedImages};

use crate::{BadReason, BuildOptions, Input, MappingError, OnBadImage, Progress, build, import};

/// A black pixel.
const PNG: &[u8] =
    b"\x89\x50\x4e\x47\x0d\x0a\x1a\x0a\x00\x00\x00\x0d\x49\x48\x44\x52\x00\x00\x00\x01\x00\x00\x00\x01\
    \x08\x00\x00\x00\x00\x3a\x7e\x9b\x55\x00\x00\x00\x0a\x49\x44\x41\x54\x78\x9c\x63\x60\x00\x00\x00\
    \x02\x00\x01\x48\xaf\xa4\x71\x00\x00\x00\x00\x49\x45\x4e\x44\xae\x42\x60\x82";

/// `a.png` to `c.png`.
fn posed(camera: &str) -> PosedImages {
    let camera: Intrinsics = camera.parse().unwrap();
    let image = |name: &str| PosedImage {
        name: name.to_owned(),
        camera,
        cam_from_world: CameraFromWorld::identity(),
        seen: Vec::new(),
    };
    PosedImages::new(["a.png", "b.png", "c.png"].map(image).to_vec(), Vec::new()).unwrap()
}

fn strings(names: &[&str]) -> Vec<String> {
    names.iter().map(|n| (*n).to_owned()).collect()
}

fn refused(posed: &PosedImages, dir: &Path, names: &[&str], options: &BuildOptions) -> MappingError {
    build(&Input::new(posed, dir).with_names(&strings(names)), options, &()).unwrap_err()
}

#[test]
fn unusable_lists_and_images_are_named() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("a.png"), PNG).unwrap();
    let options = BuildOptions::default();
    let model = posed("PINHOLE,640,480,500,500,320,240");
    let cases: [(&[&str], &str); 5] = [
        (&[], "empty"),
        (&["a.png", "a.png"], "a.png: is in the list twice"),
        (&["a.png", "d.png"], "d.png: there is no pose for it"),
        (&["b.png"], "b.png"),
        (&["a.png"], "a.png: 1x1 pixels, but its camera takes 640x480"),
    ];
    for (names, expected) in cases {
        let error = refused(&model, dir.path(), names, &options).to_string();
        assert!(error.contains(expected), "{error}");
    }
    let unknown = BuildOptions { features: "orb".to_owned(), ..BuildOptions::default() };
    let error = refused(&model, dir.path(), &["a.png"], &unknown);
    assert!(error.to_string().contains("orb") && error.to_string().contains("available: sift"), "{error}");
    let blank = refused(&posed("PINHOLE,1,1,1,1,0.5,0.5"), dir.path(), &["a.png"], &options);
    assert!(matches!(blank, MappingError::NoKeypoints { images: 1, .. }), "{blank}");
    let empty = ColmapModel::new(Vec::new(), Vec::new(), Vec::new()).unwrap();
    let none = PosedImages::from(&empty);
    let nothing = import(&empty, &Input::new(&none, dir.path()), &options, &());
    assert!(matches!(nothing, Err(MappingError::EmptyList)));
}

/// Records that extraction began.
struct Begun(AtomicBool);

impl Progress for Begun {
    fn start(&self, _stage: &str, _total: usize) {
        self.0.store(true, Ordering::Relaxed);
    }

    fn advance(&self, _steps: usize) {}

    fn finish(&self) {}
}

#[test]
fn missing_images_are_named_before_extraction() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("a.png"), PNG).unwrap();
    std::fs::create_dir(dir.path().join("c.png")).unwrap();
    let (model, begun) = (posed("PINHOLE,1,1,1,1,0.5,0.5"), Begun(AtomicBool::new(false)));
    let names = strings(&["a.png", "b.png", "a.png", "d.png", "c.png"]);
    let input = Input::new(&model, dir.path()).with_names(&names);
    let Err(MappingError::BadImages(bad)) = build(&input, &BuildOptions::default(), &begun) else {
        panic!("four bad ones")
    };
    assert!(!begun.0.load(Ordering::Relaxed), "extraction began");
    assert_eq!(bad.of, 5);
    let reasons: Vec<(&str, bool)> = bad
        .images
        .iter()
        .zip([
            |r: &BadReason| matches!(r, BadReason::NoFile { .. }),
            |r: &BadReason| matches!(r, BadReason::Twice),
            |r: &BadReason| matches!(r, BadReason::NoPose),
            |r: &BadReason| matches!(r, BadReason::NoFile { .. }),
        ])
        .map(|(image, is)| (image.name.as_str(), is(&image.reason)))
        .collect();
    assert_eq!(reasons, [("b.png", true), ("a.png", true), ("d.png", true), ("c.png", true)]);
}

#[test]
fn bad_images_are_skipped_on_request() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("a.png"), PNG).unwrap();
    std::fs::write(dir.path().join("b.png"), &PNG[..40]).unwrap();
    let model = posed("PINHOLE,1,1,1,1,0.5,0.5");
    let input = Input::new(&model, dir.path()).on_bad_image(OnBadImage::Skip);
    // One blank image remains: no vocabulary can be trained on it.
    let blank = build(&input, &BuildOptions::default(), &()).unwrap_err();
    assert!(matches!(blank, MappingError::NoKeypoints { images: 1, .. }), "{blank}");
    // No image remains.
    let names = strings(&["c.png", "b.png"]);
    let none = build(&input.with_names(&names), &BuildOptions::default(), &()).unwrap_err();
    assert!(matches!(&none, MappingError::BadImages(bad) if bad.images.len() == 1), "{none}");
    // If images must not be left out, one error names all, including those that fail only when they are read.
    let input = input.on_bad_image(OnBadImage::Refuse);
    let names = strings(&["b.png", "a.png"]);
    let cut = build(&input.with_names(&names), &BuildOptions::default(), &()).unwrap_err();
    assert!(matches!(&cut, MappingError::BadImages(bad) if bad.of == 2 && bad.images.len() == 1), "{cut}");
    assert!(cut.to_string().contains("b.png"), "{cut}");
}

type Change = (&'static str, fn(&mut BuildSettings));

#[test]
fn settings_out_of_range_are_refused() {
    let model = posed("PINHOLE,640,480,500,500,320,240");
    let changes: [Change; 8] = [
        ("max_keypoints", |s| s.extraction.max_keypoints = 0),
        ("max_image_side", |s| s.extraction.max_image_side = 63),
        ("vocabulary_words", |s| s.vocabulary_words = 0),
        ("pairs_per_image", |s| s.pairs_per_image = 0),
        ("max_ratio", |s| s.max_ratio = f32::NAN),
        ("max_epipolar_error_px", |s| s.max_epipolar_error_px = -1.0),
        ("max_reprojection_error_px", |s| s.max_reprojection_error_px = f64::INFINITY),
        ("min_track_length", |s| s.min_track_length = 1),
    ];
    for (name, change) in changes {
        let mut options = BuildOptions::default();
        change(&mut options.settings);
        let error = refused(&model, Path::new("."), &["a.png"], &options);
        assert!(
            matches!(error, MappingError::Map(MapError::Setting { setting, .. }) if setting == name),
            "{error}"
        );
    }
}
