//! Cameras from EXIF: data of real cameras, unusable data, and arbitrary bytes.

use image::DynamicImage;
use veiloc_features::{FeatureError, exif_camera, exif_camera_of, guessed_camera};
use veiloc_geometry::Intrinsics;
use veiloc_testing::exif as made;
use veiloc_testing::exif::Field::{Long, Rational, Short};
use veiloc_testing::exif::{
    DIGITAL_ZOOM, FOCAL_35MM, FOCAL_LENGTH, Field, ORIENTATION, PIXEL_X, PIXEL_Y, PLANE_UNIT,
    PLANE_X_RESOLUTION,
};

fn camera_of(name: &str, size: (u32, u32), metadata: Option<Vec<u8>>) -> Result<Intrinsics, FeatureError> {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join(name);
    made::save(&path, &DynamicImage::new_rgb8(size.0, size.1), metadata);
    let camera = exif_camera(&path);
    let file = std::fs::read(&path).expect("a file");
    // In a browser, which may turn the image.
    assert_eq!(exif_camera_of(&path, &file, size).ok(), camera.as_ref().ok().copied());
    let turned = exif_camera_of(&path, &file, (size.1, size.0)).ok();
    assert_eq!(turned.map(|c| c.pinhole().focal), camera.as_ref().ok().map(|c| c.pinhole().focal));
    camera
}

fn focal(size: (u32, u32), exif: &[Field]) -> Result<f64, FeatureError> {
    let camera = camera_of("a.jpg", size, Some(made::tiff(&[], exif)))?;
    let pinhole = camera.pinhole();
    assert_eq!((camera.width, camera.height), size);
    assert_eq!(pinhole.principal, [f64::from(size.0) / 2.0, f64::from(size.1) / 2.0]);
    assert_eq!(pinhole.focal[0], pinhole.focal[1]);
    Ok(pinhole.focal[0])
}

#[test]
fn focal_length_from_exif_of_cameras() {
    let close = |size, fields: &[Field], expected: f64| {
        let computed = focal(size, fields).unwrap_or_else(|e| panic!("{fields:?}: {e}"));
        assert!((computed / expected - 1.0).abs() < 1e-9, "{fields:?}: {computed} instead of {expected}");
    };
    let diagonal = 36.0_f64.hypot(24.0);
    // 26 mm of film on a 4:3 sensor, at full size and as a scaled-down copy, upright and lying.
    close((400, 300), &[Short(FOCAL_35MM, 26)], 26.0 * 500.0 / diagonal);
    close((300, 400), &[Short(FOCAL_35MM, 26)], 26.0 * 500.0 / diagonal);
    close(
        (400, 300),
        &[Long(PIXEL_X, 4000), Long(PIXEL_Y, 3000), Short(FOCAL_35MM, 26)],
        26.0 * 500.0 / diagonal,
    );
    // On film itself the width gives the same as the diagonal.
    close((360, 240), &[Short(FOCAL_35MM, 50)], 500.0);
    // A reflex camera: 18 mm, 4438.356 pixels per inch of its sensor, 3888 pixels wide.
    let reflex = |unit, resolution: (u32, u32), zoom: Option<(u32, u32)>| {
        let zoom = zoom.map(|(a, b)| Rational(DIGITAL_ZOOM, a, b));
        let rest = [
            Rational(FOCAL_LENGTH, 18, 1),
            Short(PIXEL_X, 3888),
            Short(PIXEL_Y, 2592),
            Rational(PLANE_X_RESOLUTION, resolution.0, resolution.1),
            Short(PLANE_UNIT, unit),
        ];
        rest.into_iter().chain(zoom).collect::<Vec<_>>()
    };
    let expected = 18.0 * 4438.356 / 25.4;
    close((3888, 2592), &reflex(2, (4_438_356, 1000), None), expected);
    close((486, 324), &reflex(2, (4_438_356, 1000), None), expected / 8.0);
    close((324, 486), &reflex(2, (4_438_356, 1000), None), expected / 8.0);
    close((486, 324), &reflex(2, (4_438_356, 1000), Some((3, 2))), 1.5 * expected / 8.0);
    close((486, 324), &reflex(2, (4_438_356, 1000), Some((0, 1))), expected / 8.0);
    close((3888, 2592), &reflex(3, (1_747_384, 1000), None), 18.0 * 1747.384 / 10.0);
    // Both: the one that needs fewer assumptions.
    let both: Vec<Field> = reflex(2, (1, 1), None).into_iter().chain([Short(FOCAL_35MM, 29)]).collect();
    close((486, 324), &both, 29.0 * 486.0_f64.hypot(324.0) / diagonal);
    // Unknown is written as 0.
    let unknown: Vec<Field> =
        reflex(2, (4_438_356, 1000), None).into_iter().chain([Short(FOCAL_35MM, 0)]).collect();
    close((3888, 2592), &unknown, expected);
}

/// Files of piexif and of thermal cameras: other readers take what is whole.
#[test]
fn whole_fields_of_damaged_exif_are_used() {
    let expected = focal((400, 300), &[Short(FOCAL_35MM, 26)]).expect("a focal length");
    let fields = [Short(FOCAL_35MM, 26), Rational(FOCAL_LENGTH, 42, 10)];
    let whole = made::tiff(&[], &fields);
    // Without the value of the last field, and then without the link behind the directory too.
    for cut in [4, 8, 12] {
        let camera =
            camera_of("a.jpg", (400, 300), Some(whole[..whole.len() - cut].to_vec())).expect("a camera");
        assert_eq!(camera.pinhole().focal[0], expected, "{cut} bytes are missing");
    }
    let short = made::tiff(&[], &fields[..1]);
    let camera = camera_of("a.jpg", (400, 300), Some(short[..short.len() - 4].to_vec())).expect("a camera");
    assert_eq!(camera.pinhole().focal[0], expected, "the link behind the directory is missing");
}

#[test]
fn unusable_exif_is_rejected_with_a_reason() {
    let refused = |found: Result<f64, FeatureError>, word: &str| {
        let error = found.expect_err("refused");
        assert!(matches!(error, FeatureError::NoFocal { .. }), "{error}");
        let message = error.to_string();
        assert!(
            message.contains("a.jpg") && message.contains(word) && message.contains("camera"),
            "{word}: {message}"
        );
    };
    refused(camera_of("a.jpg", (40, 30), None).map(|_| 0.0), "no EXIF");
    refused(camera_of("a.jpg", (40, 30), Some(b"nonsense".to_vec())).map(|_| 0.0), "damaged");
    let camera_from = |fields: &[Field]| focal((400, 300), fields);
    refused(camera_from(&[]), "does not give");
    refused(camera_from(&[Rational(FOCAL_LENGTH, 18, 1)]), "does not give");
    refused(
        camera_from(&[Rational(FOCAL_LENGTH, 18, 0), Rational(PLANE_X_RESOLUTION, 4000, 1)]),
        "does not give",
    );
    let unit =
        |unit| [Rational(FOCAL_LENGTH, 4, 1), Rational(PLANE_X_RESOLUTION, 4000, 1), Short(PLANE_UNIT, unit)];
    refused(camera_from(&unit(9)), "does not give");
    refused(camera_from(&[Short(FOCAL_35MM, 60_000)]), "possible range");
    refused(camera_from(&[Short(FOCAL_35MM, 1)]), "possible range");
    refused(camera_from(&[Long(PIXEL_X, 4000), Long(PIXEL_Y, 4000), Short(FOCAL_35MM, 26)]), "cropped");
}

#[test]
fn exif_orientation_is_ignored() {
    for orientation in 1..=8 {
        let metadata = made::tiff(&[Short(ORIENTATION, orientation)], &[Short(FOCAL_35MM, 28)]);
        for name in ["a.jpg", "a.png"] {
            let camera = camera_of(name, (400, 300), Some(metadata.clone())).expect("a camera");
            assert_eq!((camera.width, camera.height), (400, 300), "{name} {orientation}");
        }
    }
}

#[test]
fn guessed_focal_length_is_from_the_longer_side() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("a.jpg");
    made::save(&path, &DynamicImage::new_rgb8(300, 400), None);
    assert_eq!(guessed_camera(&path).expect("an image").pinhole().focal, [480.0; 2]);
    let missing = folder.path().join("no.jpg");
    for refused in [guessed_camera(&missing), exif_camera(&missing)] {
        assert!(matches!(refused, Err(FeatureError::Read { .. })), "{refused:?}");
    }
}

/// Truncated metadata and many changed bytes: rejected, or read as some camera; never a panic.
#[test]
fn arbitrary_metadata_never_panics() {
    let fields =
        [Rational(FOCAL_LENGTH, 18, 1), Short(PIXEL_X, 400), Short(PIXEL_Y, 300), Short(FOCAL_35MM, 27)];
    let whole = made::tiff(&[Short(ORIENTATION, 6)], &fields);
    let read = |metadata: Vec<u8>| {
        if let Ok(camera) = camera_of("a.png", (8, 6), Some(metadata)) {
            let focal = camera.pinhole().focal[0];
            assert!((0.8..=800.0).contains(&focal), "{focal}");
        }
    };
    for cut in 0..whole.len() {
        read(whole[..cut].to_vec());
    }
    for at in 0..whole.len() {
        for value in [0, 1, 0x7F, 0xFF] {
            let mut changed = whole.clone();
            changed[at] = value;
            read(changed);
        }
    }
}
