//! Sealing through its public API: which keypoints are selected, which input is rejected, and no input causes a panic.

use super::common;

use common::{
    camera, features_at, options, profile, random_descriptors, rng, seal, seal_with_truth, uniform_pixels,
};
use proptest::prelude::*;
use veiloc_features::{Features, Keypoint};
use veiloc_geometry::{Intrinsics, Pixel};
use veiloc_obfuscation::{SealError, obfuscate_points};
use veiloc_protocol::{AngleBits, ExtractionLimits, Observations, QueryError, Scheme, SealedQuery};

const SCHEMES: [&str; 6] =
    ["points", "random-lines", "coordinate-permutation", "dcl", "dcl:horizontal", "dcl:angle=30,s=2"];

/// Distance of a row's observation from a pixel.
fn off(observations: &Observations, row: usize, pixel: Pixel) -> f64 {
    match observations {
        Observations::Points(pixels) => pixels[row].distance(&pixel),
        Observations::Lines(lines) => lines[row].signed_distance(pixel).abs(),
        Observations::EitherLine(lines) => {
            lines[row].iter().map(|l| l.signed_distance(pixel).abs()).fold(f64::INFINITY, f64::min)
        }
        Observations::Anchored { pencils, lines } => {
            let line = pencils.line(lines[row].anchor, lines[row].angle).expect("it meets the image");
            line.signed_distance(pixel).abs()
        }
    }
}

#[test]
fn observations_match_keypoints_within_dither_and_rounding() {
    for text in SCHEMES {
        for camera in
            [camera(), "OPENCV,1000,800,900,905,510,390,-0.15,0.05,0.001,-0.0007".parse().expect("valid")]
        {
            let features = features_at(&uniform_pixels(700, 1), 1);
            let (query, truth) =
                seal_with_truth(features.clone(), &camera, &profile(), &options(text), &mut rng(1))
                    .expect(text);
            assert_eq!((query.len(), query.scheme().to_string().as_str()), (512, text));
            let observations = query.observations();
            for row in 0..query.len() {
                let pixel = truth.pixels[row];
                let source = truth.source[row].expect("700 are more than 512: no decoys");
                let device = camera.unproject(features.keypoints[source].pixel).expect("a ray");
                assert!(query.camera().project(device).distance(&pixel) < 1e-9);
                assert_eq!(query.descriptors().expect("rows").row(row), features.descriptors.row(source));
                // Dither of half a pixel in each direction, and either an eighth of rounding or half a 12-bit step at
                // the far corner (1300 pixels for s = 2).
                assert!(off(&observations, row, pixel) < 0.708 + 0.5, "{text}");
            }
            assert_eq!(SealedQuery::decode(&query.encode()).expect("own bytes"), query);
            profile().check(&query).expect("its own profile");
        }
    }
}

#[test]
fn queries_depend_only_on_input_and_generator() {
    for text in SCHEMES {
        let bytes = |seed| {
            let features = features_at(&uniform_pixels(300, 2), 2);
            seal(features, &camera(), &profile(), &options(text), &mut rng(seed)).expect(text).encode()
        };
        assert_eq!(bytes(1), bytes(1), "{text}");
        assert_ne!(bytes(1), bytes(2), "{text}");
    }
}

#[test]
fn unsealable_images_are_rejected() {
    let seal_at = |pixels: &[Pixel], scheme: &str| {
        seal(features_at(pixels, 3), &camera(), &profile(), &options(scheme), &mut rng(3)).map(|q| q.len())
    };
    for scheme in SCHEMES {
        assert!(matches!(seal_at(&[], scheme), Err(SealError::NoKeypoints { extracted: 0 })));
        // Outside of the image: the camera does not belong to these keypoints.
        let outside = [Pixel::new(-50.0, 10.0), Pixel::new(10.0, 1000.0)];
        assert!(matches!(seal_at(&outside, scheme), Err(SealError::NoKeypoints { extracted: 2 })));
    }
    let left: Vec<Pixel> = uniform_pixels(100, 3).iter().map(|p| Pixel::new(p.u / 3.0, p.v)).collect();
    assert!(matches!(seal_at(&left, "dcl:paper"), Err(SealError::OneSided { keypoints: 100 })));
    assert_eq!(seal_at(&left, "dcl").ok(), Some(256), "the default needs no remedy");
    assert_eq!(seal_at(&left, "dcl:horizontal").ok(), Some(256), "the remedy of the error works");
    assert_eq!(seal_at(&left, "random-lines").ok(), Some(256));
    // Keypoints on both sides, but on one of them only within a pixel of its anchor.
    let near: Vec<Pixel> = left.iter().copied().chain([Pixel::new(320.5, 479.9)]).collect();
    assert!(matches!(seal_at(&near, "dcl:paper"), Err(SealError::OneSided { keypoints: 100 })));

    let mut unpaired = features_at(&left, 3);
    unpaired.keypoints.pop();
    let error = seal(unpaired, &camera(), &profile(), &options("dcl"), &mut rng(3)).expect_err("unpaired");
    assert!(matches!(error, SealError::Unpaired { keypoints: 99, descriptors: 100 }));

    let absurd: Intrinsics = "SIMPLE_PINHOLE,640,480,2,320,240".parse().expect("a number");
    let error =
        seal(features_at(&left, 3), &absurd, &profile(), &options("dcl"), &mut rng(3)).expect_err("2 px");
    assert!(matches!(error, SealError::Query(QueryError::Focal { .. })));
}

#[test]
fn strongest_keypoints_are_selected_within_the_limit() {
    let mut features = features_at(&uniform_pixels(1000, 4), 4);
    for (i, keypoint) in features.keypoints.iter_mut().enumerate() {
        keypoint.response = if i == 999 { f32::NAN } else { i as f32 };
    }
    let limits = ExtractionLimits { max_keypoints: 600, max_image_side: 1600 };
    for (profile, expected) in [
        (profile(), 512),
        (profile().with_limits(limits).expect("allowed"), 512),
        (profile().with_limits(ExtractionLimits { max_keypoints: 400, ..limits }).expect("allowed"), 256),
    ] {
        let (_, truth) = seal_with_truth(features.clone(), &camera(), &profile, &options("dcl"), &mut rng(4))
            .expect("sealed");
        let mut selected: Vec<usize> = truth.source.into_iter().flatten().collect();
        selected.sort_unstable();
        // Keypoint 999 has no valid strength and comes last, so 998 is the strongest.
        assert_eq!(selected, (999 - expected..999).collect::<Vec<_>>());
    }
}

#[test]
fn device_may_send_fewer_keypoints_than_requested() {
    let mut features = features_at(&uniform_pixels(1000, 4), 4);
    for (i, keypoint) in features.keypoints.iter_mut().enumerate() {
        keypoint.response = i as f32;
    }
    let profile = profile();
    for (most, rows) in [(usize::MAX, 512), (600, 512), (511, 256), (256, 256), (40, 256)] {
        let options = options("dcl").with_max_keypoints(most);
        let query = seal(features.clone(), &camera(), &profile, &options, &mut rng(4)).expect("sealed");
        assert_eq!(query.len(), rows, "{most}");
        // The map accepts it like a query of full size.
        assert_eq!(profile.check(&query), Ok(()));
        // Rows that are not decoys are the strongest keypoints: the last of the image.
        let sent = |i: usize| {
            (0..query.len())
                .any(|row| query.descriptors().expect("rows").row(row) == features.descriptors.row(i))
        };
        let selected = most.min(rows);
        assert!((1000 - selected..1000).all(sent) && !(0..1000 - selected).any(sent), "{most}");
    }
    let none = options("dcl").with_max_keypoints(0);
    let error = seal(features, &camera(), &profile, &none, &mut rng(4)).expect_err("nothing to send");
    assert!(matches!(error, SealError::NoneAllowed), "{error}");
}

#[test]
fn bare_points_keep_their_order_and_share_lines() {
    let mut points = uniform_pixels(101, 5);
    points.push(points[0]); // one keypoint with two map points
    for text in SCHEMES {
        let scheme: Scheme = text.parse().expect("a scheme");
        let observations =
            obfuscate_points(&points, 640, 480, &scheme, AngleBits::default(), &mut rng(5)).expect(text);
        assert_eq!(observations.len(), 102);
        for (row, point) in points.iter().enumerate() {
            assert!(off(&observations, row, *point) < 0.708 + 0.5, "{text} row {row}");
        }
        let same = match &observations {
            Observations::Points(rows) => rows[0] == rows[101],
            Observations::Lines(rows) => rows[0] == rows[101],
            Observations::EitherLine(rows) => rows[0] == rows[101],
            Observations::Anchored { lines, .. } => lines[0] == lines[101],
        };
        assert!(same, "{text}");
        // Any number of points: none, one, a ring of three.
        for n in [0, 1, 2, 3, 5] {
            let some = obfuscate_points(&points[..n], 640, 480, &scheme, AngleBits::default(), &mut rng(5));
            assert_eq!(some.expect(text).len(), n);
        }
    }
    let bad = |p: Pixel| {
        let points = [points[0], points[0], p];
        obfuscate_points(&points, 640, 480, &Scheme::Points, AngleBits::default(), &mut rng(5))
    };
    assert!(matches!(bad(Pixel::new(0.0, f64::INFINITY)), Err(SealError::NotFinite { index: 2 })));
    assert!(matches!(bad(Pixel::new(0.0, 1e6)), Err(SealError::TooFar { index: 2 })));
}

/// Coordinate permutation hides which coordinate is the keypoint's own, and hardly any position stays complete.
#[test]
fn permuted_position_has_one_own_coordinate() {
    let points = uniform_pixels(1001, 6); // odd: the last three form a ring
    let scheme = Scheme::CoordinatePermutation;
    let observations =
        obfuscate_points(&points, 640, 480, &scheme, AngleBits::default(), &mut rng(6)).expect("finite");
    let Observations::EitherLine(lines) = observations else { panic!("permuted") };
    let (mut own_u, mut own_v) = (0, 0);
    for ([horizontal, vertical], point) in lines.iter().zip(&points) {
        let near = [vertical, horizontal].map(|l| l.signed_distance(*point).abs() <= 0.626);
        assert!(near[0] || near[1]);
        own_u += usize::from(near[0]);
        own_v += usize::from(near[1]);
    }
    assert!((own_u + own_v) < 1010, "hardly any position stays complete");
    assert!(own_u > 400 && own_v > 400, "the coin is fair: {own_u} {own_v}");
}

fn any_coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -100.0..800.0_f64,
        1 => any::<f64>(),
        1 => prop::sample::select(vec![0.0, -0.0, 320.0, 240.0, 640.0, 480.0, f64::NAN, f64::INFINITY, 1e300]),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn sealing_never_panics(
        pixels in prop::collection::vec((any_coordinate(), any_coordinate(), any::<f32>()), 0..60),
        scheme in 0..SCHEMES.len(),
        bits in AngleBits::MIN..=AngleBits::MAX,
        seed in any::<u64>(),
        focal in 1.0..3000.0_f64,
        k in -0.6..0.6_f64,
    ) {
        let keypoints: Vec<Keypoint> = pixels
            .iter()
            .map(|&(u, v, response)| Keypoint { pixel: Pixel::new(u, v), scale: response, orientation: 0.0, response })
            .collect();
        let descriptors = random_descriptors(keypoints.len(), &mut rng(seed));
        let bad = keypoints.iter().position(|k| !k.pixel.is_finite());
        let camera = Intrinsics::new("SIMPLE_RADIAL", 640, 480, &[focal, 320.0, 240.0, k]).expect("valid");
        let options = options(SCHEMES[scheme]).with_angle_bits(AngleBits::new(bits).expect("allowed"));
        let sealed = seal(Features { keypoints, descriptors, global: None }, &camera, &profile(), &options, &mut rng(seed));
        match (&sealed, bad) {
            (Err(SealError::NotFinite { index }), bad) => prop_assert_eq!(Some(*index), bad),
            (_, Some(_)) => prop_assert!(false, "a position that is not finite was let through"),
            (Ok(query), None) => {
                prop_assert_eq!(query.len(), 256);
                prop_assert_eq!(&SealedQuery::decode(&query.encode()).expect("own bytes"), query);
            }
            (Err(_), None) => {}
        }
    }

    #[test]
    fn obfuscating_points_never_panics(
        points in prop::collection::vec((any_coordinate(), any_coordinate()), 0..40),
        scheme in 0..SCHEMES.len(),
        (width, height) in (0..10_000_u32, 0..10_000_u32),
        seed in any::<u64>(),
    ) {
        let points: Vec<Pixel> = points.into_iter().map(|(u, v)| Pixel::new(u, v)).collect();
        let scheme: Scheme = SCHEMES[scheme].parse().expect("a scheme");
        if let Ok(observations) = obfuscate_points(&points, width, height, &scheme, AngleBits::default(), &mut rng(seed)) {
            prop_assert_eq!(observations.len(), points.len());
        }
    }
}
