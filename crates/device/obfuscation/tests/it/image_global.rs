//! L14, the global descriptor of the image: none is sent without the owner's consent to its model, and it does not
//! depend on pixels under a mask.

use super::common;

use std::path::{Path, PathBuf};

use common::{options, profile, rng, seal, seal_in};
use image::{GrayImage, Luma};
use veiloc_descriptor::{DescriptorKind, GlobalDescriptor, GlobalModel, NamedGlobal};
use veiloc_features::{FeatureError, Features, GlobalExtractor, Image, Mask, SharedGlobal, load_gray};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{Orientation, SealError, SealOptions, Sealer, Session, SessionOptions};
use veiloc_protocol::{Profile, SealedQuery, SizeClass};

const WIDE: u32 = 16;
const HIGH: u32 = 12;

/// A thumbnail as global descriptor: every pixel of the image influences a code.
struct Thumbnail(&'static str, usize);

impl GlobalExtractor for Thumbnail {
    fn model(&self) -> NamedGlobal {
        NamedGlobal::new(self.0, self.1).expect("in range")
    }

    fn describe(&self, image: &Image) -> Result<GlobalDescriptor, FeatureError> {
        let small = image.gray().resized(WIDE, HIGH);
        Ok(GlobalDescriptor::new(small.data().iter().map(|s| (s * 127.0).round() as i8).collect()))
    }
}

fn camera() -> Intrinsics {
    "SIMPLE_PINHOLE,320,240,256,160,120".parse().expect("valid")
}

fn thumbnail() -> SharedGlobal {
    SharedGlobal::new(Thumbnail("thumbnail", (WIDE * HIGH) as usize))
}

fn asking(name: &str, codes: usize) -> Profile {
    let model = GlobalModel::Named(NamedGlobal::new(name, codes).expect("in range"));
    Profile::new(DescriptorKind::ROOT_SIFT, model).expect("a profile")
}

fn thumbnail_profile() -> Profile {
    asking("thumbnail", (WIDE * HIGH) as usize)
}

/// Gray blocks; the hidden part is filled with other ones, depending on `hidden`.
fn scene(folder: &Path, hidden: u32) -> PathBuf {
    let mask = mask();
    let pixel = |x: u32, y: u32| {
        let own = if mask.hides(x, y) { hidden } else { 1 };
        let (a, b) = (x / 9, y / 9);
        Luma([((a * 37 + b * 91 + (a ^ b) * 53) * own % 251) as u8])
    };
    let path = folder.join(format!("{hidden}.png"));
    GrayImage::from_fn(320, 240, pixel).save(&path).expect("written");
    path
}

fn mask() -> Mask {
    Mask::new(320, 240, |x, y| (100..180).contains(&x) && (45..165).contains(&y)).expect("a part")
}

/// Features of an image, with its global descriptor where the profile requests it.
fn extract(image: &Path, mask: Option<&Mask>, profile: &Profile, options: &SealOptions) -> Features {
    let image = Image::open(image).expect("written");
    let image = mask.map_or(Ok(image.clone()), |mask| image.without(mask)).expect("of its size");
    let sealer = Sealer::new(profile, options.clone()).expect("the owner consented");
    sealer.extract(image, camera()).expect("extracted").features().clone()
}

/// Whatever a profile requests: without consent to this model there is no sealer.
#[test]
fn l14_requires_consent_to_the_model() {
    let folder = tempfile::tempdir().expect("a folder");
    let image = scene(folder.path(), 1);
    let others = [
        SealOptions::default(),
        SealOptions::default().with_image_global(SharedGlobal::new(Thumbnail("another", 192))),
        SealOptions::default().with_image_global(SharedGlobal::new(Thumbnail("thumbnail", 191))),
    ];
    let asking = thumbnail_profile();
    let refused = SealError::GlobalOfImage { name: "thumbnail".to_owned(), codes: 192 }.to_string();
    for own in &others {
        let sealer = Sealer::new(&asking, own.clone());
        assert_eq!(sealer.expect_err("no consent").to_string(), refused);
    }
    let own = SealOptions::default().with_image_global(thumbnail());
    assert!(extract(&image, None, &asking, &own).global.is_some(), "the owner consented");
}

/// A map that requests no global descriptor gets none: the bytes equal those without consent.
#[test]
fn l14_consent_sends_only_requested_descriptors() {
    let folder = tempfile::tempdir().expect("a folder");
    let image = scene(folder.path(), 1);
    let bytes = |own: &SealOptions| {
        let features = extract(&image, None, &profile(), own);
        assert_eq!(features.global, None);
        seal(features, &camera(), &profile(), own, &mut rng(3)).expect("sealed").encode()
    };
    let plain = options("dcl");
    assert!(bytes(&plain) == bytes(&plain.clone().with_image_global(thumbnail())));
}

/// Two images that differ only under the mask give the same bytes, including the image's global descriptor.
#[test]
fn l14_masked_pixels_are_excluded() {
    let folder = tempfile::tempdir().expect("a folder");
    let images = [scene(folder.path(), 1), scene(folder.path(), 3)];
    let (asking, own) = (thumbnail_profile(), options("dcl").with_image_global(thumbnail()));
    let sealed = |image: &PathBuf| {
        let features = extract(image, Some(&mask()), &asking, &own);
        seal(features, &camera(), &asking, &own, &mut rng(5)).expect("sealed")
    };
    assert!(sealed(&images[0]).encode() == sealed(&images[1]).encode());
    // The leak: a global descriptor of the whole image beside rows of the visible part.
    let leak = |image: &PathBuf| {
        let features = extract(image, Some(&mask()), &asking, &own);
        let whole = Image::from(load_gray(image).expect("written"));
        let features = Features { global: Some(thumbnail().describe(&whole).expect("made")), ..features };
        seal(features, &camera(), &asking, &own, &mut rng(5)).expect("sealed")
    };
    assert!(leak(&images[0]).encode() != leak(&images[1]).encode(), "the measure does not see the leak");
    assert!(sealed(&images[0]).global() != leak(&images[0]).global(), "the mask hides a part of it");
}

/// Every step of a progressive query and every frame of a session sends the extractor's descriptor; rows do not depend
/// on it.
#[test]
fn l14_steps_and_sessions_send_the_image_descriptor() {
    let folder = tempfile::tempdir().expect("a folder");
    let image = scene(folder.path(), 1);
    let (asking, own) = (thumbnail_profile(), options("dcl").with_image_global(thumbnail()));
    let features = extract(&image, None, &asking, &own);
    let made = thumbnail().describe(&Image::from(load_gray(&image).expect("written"))).expect("made");
    assert_eq!(features.global, Some(made.clone()));
    let query = seal(features.clone(), &camera(), &asking, &own, &mut rng(7)).expect("sealed");
    assert_eq!(query.global().expect("of rows"), &made);
    let query = SealedQuery::decode(&query.encode()).expect("its own bytes");
    assert_eq!(query.global().expect("of rows"), &made);
    let step = query.first_rows(SizeClass::SMALLEST, &asking).expect("a step");
    assert!(step.len() < query.len() && step.global().expect("of rows") == &made);
    let mut session = Session::new(SessionOptions::default(), &mut rng(7));
    let held = Orientation::unknown();
    let (frame, _) = seal_in(&mut session, features.clone(), &camera(), &asking, &own, &held, &mut rng(7))
        .expect("sealed");
    assert_eq!(frame.global().expect("of rows"), &made);
    // Features without their global descriptor are not sent with another one.
    let without = Features { global: None, ..features.clone() };
    assert!(matches!(seal(without, &camera(), &asking, &own, &mut rng(7)), Err(SealError::NoGlobal)));
    // The rows are the same for every global descriptor.
    let other = Features { global: Some(GlobalDescriptor::new(vec![9; 192])), ..features };
    let other = seal(other, &camera(), &asking, &own, &mut rng(7)).expect("sealed");
    assert!(other.descriptors().expect("rows").as_bytes() == query.descriptors().expect("rows").as_bytes());
    assert!(other.global() != query.global() && other.encode().len() == query.encode().len());
}

/// An extractor whose descriptor has another length than its model is an error, not a query of another length.
#[test]
fn wrong_length_descriptor_is_rejected() {
    let folder = tempfile::tempdir().expect("a folder");
    let image = scene(folder.path(), 1);
    let own = options("dcl").with_image_global(SharedGlobal::new(Thumbnail("short", 10)));
    let sealer = Sealer::new(&asking("short", 10), own).expect("the owner consented");
    let image = Image::open(&image).expect("written");
    let refused = sealer.extract(image, camera()).expect_err("192 and not 10");
    assert!(refused.to_string().contains("192 codes and not 10"), "{refused}");
}
