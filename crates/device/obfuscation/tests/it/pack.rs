//! Rules L15 and L16: nothing is sent that the pack does not explain, and a match query has no descriptor.

use std::collections::BTreeSet;

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors, Encoding};
use veiloc_features::{Features, Keypoint};
use veiloc_geometry::Pixel;
use veiloc_obfuscation::{DeviceLimits, KnownPlace, PackUse, SealError, SealOptions, Sealer};
use veiloc_protocol::{Pack, Profile, QueryContent, Scheme};

use super::common::{camera, options, profile, random_descriptors, rng, seal, seal_with_truth};

/// These rows as another image shows them.
fn seen_again(rows: &Descriptors, rng: &mut ChaCha8Rng) -> Descriptors {
    let bytes = rows.as_bytes().iter().map(|byte| byte.saturating_add(rng.random_range(0..8)));
    Descriptors::new(rows.kind(), bytes.collect()).expect("whole rows")
}

/// A pack of three images that all show these points.
fn pack_of(points: &Descriptors, profile: &Profile, seed: u64) -> Pack {
    let mut rng = rng(seed);
    let images = (0..3).map(|_| ((0..points.len() as u32).collect(), seen_again(points, &mut rng)));
    let images: Vec<(Vec<u32>, Descriptors)> = images.collect();
    Pack::new(profile.clone(), points.len() as u32, images).expect("parts fit")
}

/// Features at positions that differ, in order of falling strength.
fn features(descriptors: Descriptors) -> Features {
    let mut rng = rng(descriptors.len() as u64);
    let keypoint = |i: usize| Keypoint {
        pixel: Pixel::new(rng.random_range(10.0..630.0), rng.random_range(10.0..470.0)),
        scale: 2.0,
        orientation: 0.0,
        response: 1.0 / (1.0 + i as f32),
    };
    Features { keypoints: (0..descriptors.len()).map(keypoint).collect(), descriptors, global: None }
}

fn joined(parts: &[&Descriptors]) -> Descriptors {
    let bytes = parts.iter().flat_map(|rows| rows.as_bytes().iter().copied()).collect();
    Descriptors::new(parts[0].kind(), bytes).expect("whole rows")
}

/// A place, and an image with `of_place` of its points, after as many private rows, which are stronger.
struct Scene {
    profile: Profile,
    place: Descriptors,
    private: usize,
    shown: Descriptors,
}

fn scene(private: usize, of_place: usize) -> Scene {
    let mut rng = rng(7);
    let place = random_descriptors(600, &mut rng);
    let person = random_descriptors(private, &mut rng);
    let shown = seen_again(&place.select(0..of_place), &mut rng);
    let shown = if private > 0 { joined(&[&person, &shown]) } else { shown };
    Scene { profile: profile(), place, private, shown }
}

fn with_pack(scheme: &str, pack: Pack, usage: PackUse) -> SealOptions {
    options(scheme).with_place(KnownPlace::new(pack).expect("sift"), usage)
}

/// L15: no private row is sent, under any scheme, and nearly all others are.
#[test]
fn only_explained_rows_are_sent() {
    let Scene { profile, place, private, shown } = scene(300, 500);
    for usage in [PackUse::Explained, PackUse::Matches] {
        for scheme in Scheme::ALL.map(|scheme| scheme.to_string()) {
            let options = with_pack(&scheme, pack_of(&place, &profile, 1), usage);
            let features = features(shown.clone());
            let sealed = seal_with_truth(features, &camera(), &profile, &options, &mut rng(3));
            let (query, truth) = sealed.expect("sealed");
            let real: BTreeSet<usize> = truth.source.iter().flatten().copied().collect();
            assert!(
                real.iter().all(|source| *source >= private),
                "{scheme} {usage:?}: a private row is sent"
            );
            assert!(
                real.len() > 450 && query.len() == 512,
                "{scheme} {usage:?}: {} of {}",
                real.len(),
                query.len()
            );
        }
    }
}

/// A pack that explains everything lets through no more than is sent without one.
#[test]
fn a_hostile_pack_adds_nothing() {
    let Scene { profile, place, shown, .. } = scene(300, 500);
    let everything = pack_of(&joined(&[&place, &shown]), &profile, 2);
    let sources = |options: &SealOptions| -> BTreeSet<usize> {
        let features = features(shown.clone());
        let sealed = seal_with_truth(features, &camera(), &profile, options, &mut rng(3)).expect("sealed");
        sealed.1.source.into_iter().flatten().collect()
    };
    // Without a pack the strongest 512 of 800 are sent.
    let without = sources(&options("dcl").with_max_keypoints(512));
    for usage in [PackUse::Explained, PackUse::Matches] {
        let hostile = with_pack("dcl", everything.clone(), usage).with_max_keypoints(512);
        let with = sources(&hostile);
        assert!(with.len() > 400 && with.is_subset(&without), "{usage:?}: {}", with.len());
    }
}

/// L16: the message has no descriptor, and nothing of one: other descriptors of the same points give the same length.
#[test]
fn match_queries_name_points_without_descriptors() {
    let Scene { profile, place, private, shown } = scene(300, 500);
    let pack = pack_of(&place, &profile, 1);
    let options = with_pack("dcl", pack.clone(), PackUse::Matches);
    let sealed = seal_with_truth(features(shown.clone()), &camera(), &profile, &options, &mut rng(3));
    let (query, truth) = sealed.expect("sealed");
    assert!(query.descriptors().is_none() && query.global().is_none());
    let bytes = query.encode();
    let part_of_row = |row: usize| &shown.row(row)[..16];
    let holds = |bytes: &[u8], row: usize| bytes.windows(16).any(|window| window == part_of_row(row));
    assert!((0..shown.len()).all(|row| !holds(&bytes, row)), "a descriptor is sent");
    let with_rows = with_pack("dcl", pack.clone(), PackUse::Explained);
    let described =
        seal(features(shown.clone()), &camera(), &profile, &with_rows, &mut rng(3)).expect("sealed");
    assert!((private..shown.len()).any(|row| holds(&described.encode(), row)), "the test sees no descriptor");
    assert!(bytes.len() < 3000 && bytes.len() * 10 < described.encode().len(), "{}", bytes.len());

    let QueryContent::Matched { pack: id, matches, .. } = query.content() else { panic!("no match query") };
    assert_eq!(*id, pack.id());
    let rows = || truth.source.iter().enumerate().filter_map(|(row, source)| Some((row, (*source)?)));
    let is_right = |&(row, source): &(usize, usize)| matches.rows()[row].point as usize == source - private;
    let right = rows().filter(is_right).count();
    assert!(right * 100 > 98 * rows().count(), "{right} of {}", rows().count());
}

/// L5 with a pack: decoys fill a size class up, with points and descriptors of the place.
#[test]
fn decoys_are_of_the_place() {
    let Scene { profile, place, shown, .. } = scene(0, 180);
    let pack = pack_of(&place, &profile, 1);
    for usage in [PackUse::Explained, PackUse::Matches] {
        let options = with_pack("dcl", pack.clone(), usage);
        let (query, truth) =
            seal_with_truth(features(shown.clone()), &camera(), &profile, &options, &mut rng(3))
                .expect("sealed");
        let decoys: Vec<usize> = (0..query.len()).filter(|row| truth.source[*row].is_none()).collect();
        assert!(query.len() == 256 && (70..120).contains(&decoys.len()), "{usage:?}: {}", decoys.len());
        match query.content() {
            QueryContent::Described { descriptors, .. } => {
                let known = KnownPlace::new(pack.clone()).expect("sift");
                let rows = known.look_up(&descriptors.select(decoys)).expect("of its kind");
                let explained = rows.iter().filter(|row| row.is_explained()).count();
                assert!(explained * 10 >= rows.len() * 9, "{explained} of {}", rows.len());
                assert!((0..shown.len()).all(|row| pack.descriptors().row(row) != descriptors.row(0)));
            }
            QueryContent::Matched { matches, .. } => {
                let points: BTreeSet<u32> = decoys.iter().map(|row| matches.rows()[*row].point).collect();
                assert!(points.len() > decoys.len() / 2, "{} points", points.len());
            }
        }
    }
}

/// Rows that share a position are one row where decoys have positions of their own: sharing would show what is real.
#[test]
fn one_row_a_position_beside_decoys() {
    // Below the smallest class, and between two classes.
    for of_place in [180, 450] {
        one_row_a_position_of(of_place);
    }
}

fn one_row_a_position_of(of_place: usize) {
    let Scene { profile, place, shown, .. } = scene(0, of_place);
    let mut features = features(shown);
    for i in 0..30 {
        features.keypoints[2 * i + 1].pixel = features.keypoints[2 * i].pixel;
    }
    let pack = pack_of(&place, &profile, 1);
    for usage in [PackUse::Explained, PackUse::Matches] {
        let options = with_pack("points", pack.clone(), usage);
        let sealed = seal_with_truth(features.clone(), &camera(), &profile, &options, &mut rng(3));
        let (_, truth) = sealed.expect("sealed");
        let real = truth.source.iter().zip(&truth.pixels).filter(|(source, _)| source.is_some());
        let places: Vec<[u64; 2]> = real.map(|(_, p)| [p.u.to_bits(), p.v.to_bits()]).collect();
        let distinct: BTreeSet<[u64; 2]> = places.iter().copied().collect();
        assert!(distinct.len() == places.len() && places.len() > 100, "{usage:?}");
    }
}

/// Nothing leaves when the image shows something else.
#[test]
fn another_place_is_not_sealed() {
    let Scene { profile, place, shown, .. } = scene(300, 5);
    for usage in [PackUse::Explained, PackUse::Matches] {
        let options = with_pack("dcl", pack_of(&place, &profile, 1), usage);
        let refused = seal(features(shown.clone()), &camera(), &profile, &options, &mut rng(3));
        assert!(
            matches!(&refused, Err(e @ SealError::NotThisPlace { .. }) if e.kind().name() == "not-this-place"),
            "{refused:?}"
        );
    }
}

#[test]
fn packs_that_do_not_fit_are_refused() {
    let Scene { profile, place, .. } = scene(0, 10);
    let pack = pack_of(&place, &profile, 1);
    let other = Profile::vlad(profile.vocabulary().expect("vlad").clone())
        .with_limits(veiloc_protocol::ExtractionLimits { max_keypoints: 512, max_image_side: 640 })
        .expect("in range");
    let place = KnownPlace::new(pack).expect("sift");
    let options = SealOptions::default().with_place(place.clone(), PackUse::Matches);
    assert!(matches!(Sealer::new(&other, options.clone()), Err(SealError::PackOfOtherMap)));
    let limits = DeviceLimits { max_pack_rows: 100, ..DeviceLimits::default() };
    let refused = Sealer::new(&profile, options.with_limits(limits));
    assert!(matches!(refused, Err(SealError::PackTooLarge { rows: 1800, allowed: 100 })));

    let kind = DescriptorKind::new("own", 32, Encoding::Signed, 100).expect("a kind");
    let rows = Descriptors::new(kind, vec![7; 32]).expect("a row");
    let words = veiloc_descriptor::Vocabulary::new(rows.clone()).expect("a word");
    let own = Pack::new(Profile::vlad(words), 1, [(vec![0], rows)]).expect("parts fit");
    assert!(matches!(KnownPlace::new(own), Err(SealError::PackKind { kind }) if kind == "own"));
}
