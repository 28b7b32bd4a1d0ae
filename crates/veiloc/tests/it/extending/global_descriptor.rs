//! A user-defined global descriptor: computed from the image, identified by name on both sides.
//!
//! Devices send one only with their owners' consent (`SealOptions::with_image_global`): it reveals more than the rows
//! do.

use rand::SeedableRng;
use veiloc::device::{
    FeatureError, GlobalExtractor, Image, SealError, SealOptions, SealedQuery, Sealer, SharedGlobal,
};
use veiloc::server::{
    BuildOptions, Input, LocalizeOptions, MapFile, VocabularyUpdate, add, build, localize, remove, write_map,
};
use veiloc_descriptor::{GlobalDescriptor, NamedGlobal};

use super::rendered;

const WIDE: u32 = 16;
const HIGH: u32 = 12;

/// The reduced image minus its mean.
struct Thumbnail;

impl GlobalExtractor for Thumbnail {
    fn model(&self) -> NamedGlobal {
        NamedGlobal::new("thumbnail", (WIDE * HIGH) as usize).expect("in range")
    }

    fn describe(&self, image: &Image) -> Result<GlobalDescriptor, FeatureError> {
        let small = image.gray().resized(WIDE, HIGH);
        let mean = small.data().iter().sum::<f32>() / (WIDE * HIGH) as f32;
        let norm = small.data().iter().map(|s| (s - mean).powi(2)).sum::<f32>().sqrt().max(1e-9);
        let code = |sample: &f32| ((sample - mean) / norm * 127.0).round() as i8;
        Ok(GlobalDescriptor::new(small.data().iter().map(code).collect()))
    }
}

#[test]
fn map_with_user_defined_global_descriptor_retrieves_and_localizes() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let scene = rendered::render(folder.path(), 11).expect("rendered");
    let mut options = BuildOptions::default();
    options.global = Some(SharedGlobal::new(Thumbnail));
    let (mut model, _) = build(&Input::new(&scene.posed, &scene.folder), &options, &()).expect("built");

    // Removing and adding an image: works with the map's own extractor, and not without it.
    let name = vec![scene.posed.names()[3].clone()];
    remove(&mut model, &name, VocabularyUpdate::Keep, &()).expect("removed");
    let input = Input::new(&scene.posed, &scene.folder).with_names(&name);
    let lacking = add(&mut model, &input, &()).expect_err("no extractor of whole images");
    assert!(lacking.to_string().contains("thumbnail"), "{lacking}");
    let thumbnail = SharedGlobal::new(Thumbnail);
    add(&mut model, &input.with_global(&thumbnail), &()).expect("added");
    let file = folder.path().join("place.vmap");
    write_map(&model, &file).expect("written");
    let map = MapFile::open(&file).expect("opened");
    assert_eq!(map.profile().global_model().name(), "thumbnail");

    let (path, truth) = &scene.queries[0];
    // A device without consent refuses to seal.
    let refused = Sealer::new(map.profile(), SealOptions::default()).expect_err("no consent");
    assert!(matches!(refused, SealError::GlobalOfImage { .. }), "{refused}");
    let consenting = SealOptions::default().with_image_global(thumbnail);
    let sealer = Sealer::new(map.profile(), consenting).expect("the owner consented");
    let image = Image::open(path).expect("rendered");
    let extracted = sealer.extract(image, scene.camera).expect("extracted, and its thumbnail");
    let mut rng = rand_chacha::ChaCha20Rng::seed_from_u64(1);
    let query = sealer.seal(extracted, &mut rng).expect("sealed");
    let query = SealedQuery::decode(&query.encode()).expect("its own bytes");
    let found = localize(&query, &map, &LocalizeOptions::default()).expect("localized");
    assert!(found.cam_from_world.translation_error(truth) < 0.05, "{}", found.inliers);
    // The most similar images come first: the nearest map view is among the first three.
    let distance = |name: &str| scene.posed.get(name).expect("posed").cam_from_world.translation_error(truth);
    let nearest = scene.posed.names().into_iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
    let first: Vec<String> =
        found.retrieved.iter().take(3).map(|r| map.image(r.image).name().to_owned()).collect();
    assert!(first.contains(&nearest.expect("ten of them")), "{first:?}");
}
