//! A profile comes from somebody else. Every field at its extreme: what leaves the device stays what the device decided.

use super::common;

use common::{camera, features_at, options, profile, random_descriptors, rng, uniform_pixels};
use veiloc_descriptor::{DescriptorKind, Descriptors, Encoding, GlobalModel, NamedGlobal, Vocabulary};
use veiloc_features::{Image, load_gray};
use veiloc_obfuscation::{DeviceLimits, SealError, SealOptions, extract, extract_loaded, seal};
use veiloc_protocol::{AngleBits, ExtractionLimits, Observations, Profile, Scheme, SealedQuery};

fn sealed(profile: &Profile, options: &SealOptions, count: usize) -> Result<SealedQuery, SealError> {
    seal(features_at(&uniform_pixels(count, 1), 1), &camera(), profile, options, &mut rng(1))
}

fn limits(max_keypoints: u32, max_image_side: u32) -> ExtractionLimits {
    ExtractionLimits { max_keypoints, max_image_side }
}

/// What a refusal says.
fn said<T: std::fmt::Debug>(refused: Result<T, SealError>) -> String {
    refused.expect_err("refused").to_string()
}

/// A profile has no field for it (`the_schema_has_these_fields_and_no_more`): a device that says nothing sends `dcl` with 12
/// bits.
#[test]
fn no_profile_chooses_a_scheme_or_the_bits_of_an_angle() {
    // As it comes over the wire.
    let hostile = Profile::decode(&profile().encode()).expect("a profile");
    let query = sealed(&hostile, &SealOptions::default(), 300).expect("sealed");
    assert_eq!((query.scheme(), query.angle_bits()), (Scheme::default(), AngleBits::default()));
    assert!(matches!(query.observations(), Observations::Anchored { .. }));
    assert!(hostile.check(&query).is_ok(), "and the map takes it");
    let lines = sealed(&hostile, &options("random-lines"), 300).expect("sealed");
    assert_eq!(lines.scheme(), Scheme::RandomLines);
    assert!(hostile.check(&lines).is_ok());
}

#[test]
fn points_must_be_asked_for_by_name() {
    assert!(matches!(SealOptions::new(Scheme::Points), Err(SealError::Unprotected)));
    assert!(SealOptions::default().scheme().hides_positions());
    let query = sealed(&profile(), &SealOptions::unprotected_points(), 300).expect("sealed");
    assert_eq!(query.scheme(), Scheme::Points, "the explicit word works");
}

#[test]
fn the_number_of_keypoints_is_bounded_by_the_device() {
    let greedy = profile().with_limits(limits(4096, 1600)).expect("allowed");
    let rows = |options: &SealOptions| sealed(&greedy, options, 4200).expect("sealed").len();
    assert_eq!(rows(&SealOptions::default()), 2048);
    assert_eq!(rows(&SealOptions::default().with_max_keypoints(512)), 512);
    // Only the device's own word goes beyond its limit.
    assert_eq!(rows(&SealOptions::default().with_max_keypoints(4096)), 4096);
    // A miserly profile gets few rows, but a whole class of them: nothing tells how many are real.
    let miserly = profile().with_limits(limits(256, 64)).expect("allowed");
    assert_eq!(sealed(&miserly, &SealOptions::default(), 4200).expect("sealed").len(), 256);
    let one = SealOptions::default().with_max_keypoints(40);
    assert_eq!(sealed(&miserly, &one, 4200).expect("sealed").len(), 256);
    for bad in [limits(1, 1600), limits(u32::MAX, 1600), limits(2048, 1), limits(2048, u32::MAX)] {
        assert!(profile().with_limits(bad).is_err(), "{bad:?} is no profile at all");
    }
}

#[test]
fn the_side_of_the_image_is_bounded_by_the_device() {
    let bounded = |side| {
        let profile = profile().with_limits(limits(2048, side)).expect("allowed");
        SealOptions::default().bounded(&profile).expect("a vocabulary of eight words").max_image_side
    };
    assert_eq!((bounded(8192), bounded(1600), bounded(64)), (2048, 1600, 64));
    // The same through the door: a gradient of 3000 pixels is not extracted from as it is.
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("wide.png");
    image::GrayImage::from_fn(3000, 40, |x, y| image::Luma([(x * y % 251) as u8]))
        .save(&path)
        .expect("written");
    let huge = profile().with_limits(limits(256, 8192)).expect("allowed");
    let wide = "SIMPLE_PINHOLE,3000,40,2000,1500,20".parse().expect("valid");
    let (_, camera) = extract(&path, &wide, &huge, &SealOptions::default()).expect("extracted");
    assert_eq!((camera.width, camera.height), (2048, 27));
    // The door for images in memory is no wider.
    let image = Image::from(load_gray(&path).expect("an image"));
    let (_, camera) = extract_loaded(image, &path, &wide, &huge, &SealOptions::default()).expect("extracted");
    assert_eq!((camera.width, camera.height), (2048, 27));
}

#[test]
fn the_vocabulary_is_bounded_by_the_device() {
    let profile =
        |words: usize| Profile::vlad(Vocabulary::new(random_descriptors(words, &mut rng(3))).expect("words"));
    assert!(sealed(&profile(512), &SealOptions::default(), 300).is_ok());
    let huge = profile(Vocabulary::MAX_LEN);
    let refused = SealError::VocabularyTooLarge { words: 8192, allowed: 512 };
    assert_eq!(said(sealed(&huge, &SealOptions::default(), 300)), refused.to_string());
    let own = DeviceLimits { max_vocabulary_words: 8192, ..DeviceLimits::default() };
    assert!(sealed(&huge, &SealOptions::default().with_limits(own), 300).is_ok(), "the device's own word");
}

/// A global descriptor of the image tells of more than the rows that are sent.
#[test]
fn a_global_descriptor_of_the_image_is_refused() {
    let global = GlobalModel::Named(NamedGlobal::new("all-of-it", 16_384).expect("a model"));
    let hostile = Profile::new(DescriptorKind::ROOT_SIFT, global).expect("a profile");
    let refused = SealError::GlobalOfImage { name: "all-of-it".to_owned(), codes: 16_384 };
    assert_eq!(said(sealed(&hostile, &SealOptions::default(), 300)), refused.to_string());
}

/// Descriptors nobody here makes: an error that names what there is, before the image is read.
#[test]
fn an_unknown_kind_is_an_error() {
    let kind = DescriptorKind::new("everything", 512, Encoding::Signed, 1000).expect("a kind");
    let words = Descriptors::new(kind, vec![1; 512]).and_then(Vocabulary::new).expect("one word");
    let hostile = Profile::vlad(words);
    let camera = camera();
    let error = extract("no-such-file.png".as_ref(), &camera, &hostile, &SealOptions::default());
    let text = error.expect_err("unknown").to_string();
    assert!(text.contains("everything") && text.contains("there are: sift"), "{text}");
    assert!(matches!(sealed(&hostile, &SealOptions::default(), 300), Err(SealError::Query(_))));
    let missing = extract("no-such-file.png".as_ref(), &camera, &profile(), &SealOptions::default());
    assert!(matches!(missing, Err(SealError::Image(_))), "{missing:?}");
}

/// Other kinds get decoys too, made of the rows that are sent and never copies; a kind of too few numbers, and too few
/// rows to mix, are errors.
#[test]
fn decoys_of_other_kinds_are_no_copies() {
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
    let is_real = |row: usize| (0..60).any(|i| real.row(i) == query.descriptors().row(row));
    assert_eq!((0..query.len()).filter(|row| is_real(*row)).count(), 60, "196 decoys, none a copy");
    let length =
        |row: usize| query.descriptors().values(row).map(|v| f64::from(v).powi(2)).sum::<f64>().sqrt();
    let mean = |of: &mut dyn Iterator<Item = usize>| {
        let lengths: Vec<f64> = of.map(length).collect();
        lengths.iter().sum::<f64>() / lengths.len() as f64
    };
    let (of_real, of_decoys) =
        (mean(&mut (0..256).filter(|r| is_real(*r))), mean(&mut (0..256).filter(|r| !is_real(*r))));
    assert!((of_real / of_decoys - 1.0).abs() < 0.02, "{of_real} {of_decoys}");
    // Decoys are as far from each other and from real rows as real rows are.
    let nearest = |row: usize| {
        let own: Vec<i16> = query.descriptors().values(row).collect();
        let to = |other: usize| -> i32 {
            query.descriptors().values(other).zip(&own).map(|(a, b)| i32::from(a - *b).pow(2)).sum()
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
    assert_eq!(said(sealed(64, 2)), too_few(2));
    assert_eq!(said(sealed(8, 60)), too_few(60), "none of so short a vector");
    assert!(sealed(8, 300).is_ok(), "and none needed");
}

/// What was not sent is in no decoy: with one and the same generator, other weak keypoints change nothing.
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

/// Words could be chosen so that what is made of them stands out: no row depends on them.
#[test]
fn no_profile_has_a_part_in_decoys() {
    let kind = DescriptorKind::new("own", 64, Encoding::Signed, 100).expect("a kind");
    let rows = |words: Vec<u8>| {
        let mut draw = rng(8);
        let bytes = (0..60 * 64).map(|_| rand::Rng::random_range(&mut draw, 100..156)).collect();
        let mut features = features_at(&uniform_pixels(60, 8), 8);
        features.descriptors = Descriptors::new(kind, bytes).expect("whole rows");
        let words = Descriptors::new(kind, words).and_then(Vocabulary::new).expect("words");
        let query = seal(features, &camera(), &Profile::vlad(words), &SealOptions::default(), &mut rng(8));
        query.expect("sealed").descriptors().as_bytes().to_vec()
    };
    assert!(rows(vec![128; 64]) == rows((0..128).map(|i| if i % 64 == 0 { 255 } else { 0 }).collect()));
}
