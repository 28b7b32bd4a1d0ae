//! Bad input: each error names what is wrong and what to do.

use std::path::Path;

use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::colmap::{ColmapImage, ColmapModel};

use crate::{BuildOptions, MappingError, build, import};

/// A black pixel.
const PNG: &[u8] =
    b"\x89\x50\x4e\x47\x0d\x0a\x1a\x0a\x00\x00\x00\x0d\x49\x48\x44\x52\x00\x00\x00\x01\x00\x00\x00\x01\
    \x08\x00\x00\x00\x00\x3a\x7e\x9b\x55\x00\x00\x00\x0a\x49\x44\x41\x54\x78\x9c\x63\x60\x00\x00\x00\
    \x02\x00\x01\x48\xaf\xa4\x71\x00\x00\x00\x00\x49\x45\x4e\x44\xae\x42\x60\x82";

fn posed(camera: &str) -> ColmapModel {
    let camera: Intrinsics = camera.parse().unwrap();
    let image = |id: u32, name: &str| ColmapImage {
        id,
        name: name.to_owned(),
        camera_id: 1,
        cam_from_world: CameraFromWorld::identity(),
        points2d: Vec::new(),
    };
    ColmapModel::new(vec![(1, camera)], vec![image(1, "a.png"), image(2, "b.png")], Vec::new()).unwrap()
}

fn refused(posed: &ColmapModel, dir: &Path, names: &[&str], options: &BuildOptions) -> MappingError {
    let names: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
    build(posed, dir, &names, options, &()).unwrap_err()
}

#[test]
fn lists_and_images_that_cannot_be_used_are_named() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("a.png"), PNG).unwrap();
    let options = BuildOptions::default();
    let model = posed("PINHOLE,640,480,500,500,320,240");
    let cases: [(&[&str], &str); 5] = [
        (&[], "empty"),
        (&["a.png", "a.png"], "a.png is in the list twice"),
        (&["a.png", "c.png"], "no pose for it"),
        (&["b.png"], "b.png"),
        (&["a.png"], "1x1 pixels, but its camera takes 640x480"),
    ];
    for (names, told) in cases {
        let error = refused(&model, dir.path(), names, &options).to_string();
        assert!(error.contains(told), "{error}");
    }
    let blank = refused(&posed("PINHOLE,1,1,1,1,0.5,0.5"), dir.path(), &["a.png"], &options);
    assert!(matches!(blank, MappingError::NoKeypoints { images: 1, .. }), "{blank}");
    let empty = ColmapModel::new(Vec::new(), Vec::new(), Vec::new()).unwrap();
    assert!(matches!(import(&empty, dir.path(), &options, &()), Err(MappingError::EmptyList)));
}

type Change = (&'static str, fn(&mut BuildOptions));

#[test]
fn options_out_of_range_are_refused() {
    let model = posed("PINHOLE,640,480,500,500,320,240");
    let changes: [Change; 7] = [
        ("max_keypoints", |o| o.max_keypoints = 0),
        ("vocabulary_words", |o| o.vocabulary_words = 0),
        ("pairs_per_image", |o| o.pairs_per_image = 0),
        ("max_ratio", |o| o.max_ratio = f32::NAN),
        ("max_epipolar_error_px", |o| o.max_epipolar_error_px = -1.0),
        ("max_reprojection_error_px", |o| o.max_reprojection_error_px = f64::INFINITY),
        ("min_track_length", |o| o.min_track_length = 1),
    ];
    for (name, change) in changes {
        let mut options = BuildOptions::default();
        change(&mut options);
        let error = refused(&model, Path::new("."), &["a.png"], &options);
        assert!(matches!(error, MappingError::Option { option, .. } if option == name), "{error}");
    }
}
