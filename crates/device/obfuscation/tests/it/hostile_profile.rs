//! A profile comes from another party. With every field at its extreme, the device's own options still decide what is
//! sent.

use super::common;

use common::{camera, features_at, options, profile, random_descriptors, rng, seal, uniform_pixels};
use veiloc_descriptor::{DescriptorKind, Descriptors, Encoding, GlobalModel, NamedGlobal, Vocabulary};
use veiloc_features::{GrayImage, Image};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{DeviceLimits, SealError, SealOptions, Sealer};
use veiloc_protocol::{AngleBits, ExtractionLimits, Observations, Profile, Scheme, SealedQuery};

fn sealed(profile: &Profile, options: &SealOptions, count: usize) -> Result<SealedQuery, SealError> {
    seal(features_at(&uniform_pixels(count, 1), 1), &camera(), profile, options, &mut rng(1))
}

fn limits(max_keypoints: u32, max_image_side: u32) -> ExtractionLimits {
    ExtractionLimits { max_keypoints, max_image_side }
}

/// The error message.
fn error_text<T: std::fmt::Debug>(refused: Result<T, SealError>) -> String {
    refused.expect_err("refused").to_string()
}

/// A profile has no field for these (`schema_has_exactly_these_fields`): a device with default options sends
/// `dcl` with 12 bits.
#[test]
fn profile_cannot_choose_scheme_or_angle_bits() {
    // As it is received.
    let hostile = Profile::decode(&profile().encode()).expect("a profile");
    let query = sealed(&hostile, &SealOptions::default(), 300).expect("sealed");
    assert_eq!((query.scheme(), query.angle_bits()), (Scheme::default(), AngleBits::default()));
    assert!(matches!(query.observations(), Observations::Anchored { .. }));
    assert!(hostile.check(&query).is_ok(), "the map accepts it");
    let lines = sealed(&hostile, &options("random-lines"), 300).expect("sealed");
    assert_eq!(lines.scheme(), Scheme::RandomLines);
    assert!(hostile.check(&lines).is_ok());
}

#[test]
fn points_scheme_requires_explicit_option() {
    assert!(matches!(SealOptions::new(Scheme::Points), Err(SealError::Unprotected)));
    let random = Scheme::of_tables("dcl:random").expect("known");
    assert!(matches!(SealOptions::new(random), Err(SealError::OnlyForTables)));
    assert!(SealOptions::default().scheme().hides_positions());
    let query = sealed(&profile(), &SealOptions::unprotected_points(), 300).expect("sealed");
    assert_eq!(query.scheme(), Scheme::Points, "the explicit word works");
}

#[test]
fn device_bounds_keypoint_count() {
    let greedy = profile().with_limits(limits(4096, 1600)).expect("allowed");
    let rows = |options: &SealOptions| sealed(&greedy, options, 4200).expect("sealed").len();
    assert_eq!(rows(&SealOptions::default()), 2048);
    assert_eq!(rows(&SealOptions::default().with_max_keypoints(512)), 512);
    // Only the device's own option exceeds its default limit.
    assert_eq!(rows(&SealOptions::default().with_max_keypoints(4096)), 4096);
    // A profile with a small limit gets few rows, but a full size class: the number of real rows stays hidden.
    let miserly = profile().with_limits(limits(256, 64)).expect("allowed");
    assert_eq!(sealed(&miserly, &SealOptions::default(), 4200).expect("sealed").len(), 256);
    let one = SealOptions::default().with_max_keypoints(40);
    assert_eq!(sealed(&miserly, &one, 4200).expect("sealed").len(), 256);
    let none = SealOptions::default().with_max_keypoints(0);
    assert!(matches!(sealed(&miserly, &none, 4200), Err(SealError::NoneAllowed)));
    for bad in [limits(1, 1600), limits(u32::MAX, 1600), limits(2048, 1), limits(2048, u32::MAX)] {
        assert!(profile().with_limits(bad).is_err(), "{bad:?} is no profile at all");
    }
}

#[test]
fn device_bounds_image_side() {
    let bounded = |side| {
        let profile = profile().with_limits(limits(2048, side)).expect("allowed");
        Sealer::new(&profile, SealOptions::default()).expect("eight words").limits().max_image_side
    };
    assert_eq!((bounded(8192), bounded(1600), bounded(64)), (2048, 1600, 64));
    // A side of the device's own list, not any that a profile requests (rule L6).
    assert_eq!((bounded(1599), bounded(1025), bounded(1024), bounded(143)), (1024, 1024, 1024, 64));
    // An image 3000 pixels wide is scaled down before extraction.
    let gray = GrayImage::new(3000, 40, (0..3000 * 40).map(|i| (i % 251) as f32 / 251.0).collect());
    let huge = profile().with_limits(limits(256, 8192)).expect("allowed");
    let wide: Intrinsics = "SIMPLE_PINHOLE,3000,40,2000,1500,20".parse().expect("valid");
    let sealer = Sealer::new(&huge, SealOptions::default()).expect("eight words");
    let extracted = sealer.extract(Image::from(gray.expect("samples")), wide).expect("extracted");
    let camera = extracted.camera().intrinsics;
    assert_eq!((camera.width, camera.height), (2048, 27));
}

#[test]
fn device_bounds_vocabulary_size() {
    let profile =
        |words: usize| Profile::vlad(Vocabulary::new(random_descriptors(words, &mut rng(3))).expect("words"));
    assert!(sealed(&profile(512), &SealOptions::default(), 300).is_ok());
    let huge = profile(Vocabulary::MAX_LEN);
    let refused = SealError::VocabularyTooLarge { words: 8192, allowed: 512 };
    assert_eq!(error_text(sealed(&huge, &SealOptions::default(), 300)), refused.to_string());
    let own = DeviceLimits { max_vocabulary_words: 8192, ..DeviceLimits::default() };
    assert!(sealed(&huge, &SealOptions::default().with_limits(own), 300).is_ok(), "the device's own limit");
}

/// A global descriptor of the image reveals more than the rows that are sent.
#[test]
fn image_global_descriptor_is_rejected() {
    let global = GlobalModel::Named(NamedGlobal::new("all-of-it", 16_384).expect("a model"));
    let hostile = Profile::new(DescriptorKind::ROOT_SIFT, global).expect("a profile");
    let refused = SealError::GlobalOfImage { name: "all-of-it".to_owned(), codes: 16_384 };
    assert_eq!(error_text(sealed(&hostile, &SealOptions::default(), 300)), refused.to_string());
}

/// A descriptor kind without an extractor: the error lists the available kinds.
#[test]
fn unknown_descriptor_kind_is_an_error() {
    let kind = DescriptorKind::new("everything", 512, Encoding::Signed, 1000).expect("a kind");
    let words = Descriptors::new(kind, vec![1; 512]).and_then(Vocabulary::new).expect("one word");
    let hostile = Profile::vlad(words);
    let sealer = Sealer::new(&hostile, SealOptions::default()).expect("one word");
    let gray = GrayImage::new(640, 480, vec![0.5; 640 * 480]).expect("samples");
    let text = error_text(sealer.extract(Image::from(gray), camera()));
    assert!(text.contains("everything") && text.contains("available: sift"), "{text}");
    assert!(matches!(sealed(&hostile, &SealOptions::default(), 300), Err(SealError::Query(_))));
}

/// Other kinds get decoys too, made of the rows that are sent and never copies; kinds with too few dimensions, and too
/// few rows to blend, are errors.
#[test]
fn decoys_of_other_kinds_are_not_copies() {
    let sealed = |dim: usize, count: usize| {
        let kind = DescriptorKind::new("own", dim, Encoding::Signed, 100).expect("a kind");
        let mut draw = rng(5);
        let bytes = (0..count * dim).map(|_| rand::Rng::random_range(&mut draw, 100..156)).collect();
        let mut features = features_at(&uniform_pixels(count, 5), 5);
        features.descriptors = Descriptors::new(kind, bytes).expect("whole rows");
        let words = Descriptors::new(kind, vec![128; dim]).and_then(Vocabulary::new).expect("one word");
        let real = features.descriptors.clone();
        seal(features, &camera(), &Profile::vlad(words), &SealOptions::default(), &mut rng(5))
            .map(|query| (query, real))
    };
    let (query, real) = sealed(64, 60).expect("sealed");
    let is_real = |row: usize| (0..60).any(|i| real.row(i) == query.descriptors().expect("rows").row(row));
    assert_eq!((0..query.len()).filter(|row| is_real(*row)).count(), 60, "196 decoys, none a copy");
    let length = |row: usize| {
        query.descriptors().expect("rows").values(row).map(|v| f64::from(v).powi(2)).sum::<f64>().sqrt()
    };
    let mean = |of: &mut dyn Iterator<Item = usize>| {
        let lengths: Vec<f64> = of.map(length).collect();
        lengths.iter().sum::<f64>() / lengths.len() as f64
    };
    let (of_real, of_decoys) =
        (mean(&mut (0..256).filter(|r| is_real(*r))), mean(&mut (0..256).filter(|r| !is_real(*r))));
    assert!((of_real / of_decoys - 1.0).abs() < 0.02, "{of_real} {of_decoys}");
    // Decoys are as far from each other and from real rows as real rows are from each other.
    let nearest = |row: usize| {
        let own: Vec<i16> = query.descriptors().expect("rows").values(row).collect();
        let to = |other: usize| -> i32 {
            query
                .descriptors()
                .expect("rows")
                .values(other)
                .zip(&own)
                .map(|(a, b)| i32::from(a - *b).pow(2))
                .sum()
        };
        (0..256).filter(|other| *other != row).map(to).min().unwrap_or(0)
    };
    let median = |real: bool| {
        let mut all: Vec<i32> = (0..256).filter(|r| is_real(*r) == real).map(nearest).collect();
        all.sort_unstable();
        f64::from(all[all.len() / 2]).sqrt()
    };
    assert!(median(false) / median(true) > 0.6, "{} {}", median(false), median(true));

    let too_few = |keypoints| SealError::NoDecoys { kind: "own".to_owned(), keypoints }.to_string();
    assert_eq!(error_text(sealed(64, 2)), too_few(2));
    assert_eq!(error_text(sealed(8, 60)), too_few(60), "no decoys for so few dimensions");
    assert!(sealed(8, 300).is_ok(), "none needed");
}

/// Keypoints that are not sent have no influence on decoys: with the same generator, other weak keypoints change
/// nothing.
#[test]
fn decoys_are_made_of_sent_rows() {
    let forty = SealOptions::default().with_max_keypoints(40);
    let bytes = |others: u64, profile: &Profile| {
        let mut features = features_at(&uniform_pixels(500, 6), 6);
        let mut rows = features.descriptors.select(0..40);
        let weak = random_descriptors(460, &mut rng(others));
        for row in 0..460 {
            rows.push(weak.row(row)).expect("a row");
        }
        features.descriptors = rows;
        seal(features, &camera(), profile, &forty, &mut rng(6)).expect("sealed").encode()
    };
    assert!(bytes(1, &profile()) == bytes(2, &profile()));
}

/// An attacker could choose vocabulary words so that decoys made of them stand out: no row may depend on them.
#[test]
fn decoys_do_not_depend_on_profile() {
    let kind = DescriptorKind::new("own", 64, Encoding::Signed, 100).expect("a kind");
    let rows = |words: Vec<u8>| {
        let mut draw = rng(8);
        let bytes = (0..60 * 64).map(|_| rand::Rng::random_range(&mut draw, 100..156)).collect();
        let mut features = features_at(&uniform_pixels(60, 8), 8);
        features.descriptors = Descriptors::new(kind, bytes).expect("whole rows");
        let words = Descriptors::new(kind, words).and_then(Vocabulary::new).expect("words");
        let query = seal(features, &camera(), &Profile::vlad(words), &SealOptions::default(), &mut rng(8));
        query.expect("sealed").descriptors().expect("rows").as_bytes().to_vec()
    };
    assert!(rows(vec![128; 64]) == rows((0..128).map(|i| if i % 64 == 0 { 255 } else { 0 }).collect()));
}
