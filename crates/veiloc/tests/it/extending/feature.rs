//! A user-defined local feature: an extractor and its descriptor kind.

use rand::SeedableRng;
use veiloc::device::{Extractor, Extractors, FeatureError, Features, Image, SealOptions, Sealer, Sift};
use veiloc::server::{BuildOptions, Input, LocalizeOptions, MapFile, build, localize, write_map};
use veiloc_descriptor::{DescriptorKind, Descriptors, Encoding};

use super::rendered;

/// Side of the sampled patch, samples.
const SIDE: i32 = 9;

/// SIFT's keypoints, described by the surrounding gray values minus their mean: signed, 81 numbers.
struct Patches;

impl Patches {
    const NORM: f64 = 300.0;
}

impl Extractor for Patches {
    fn kind(&self) -> DescriptorKind {
        let dim = (SIDE * SIDE) as usize;
        DescriptorKind::new("patches", dim, Encoding::Signed, Self::NORM as u32).expect("in range")
    }

    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError> {
        let mut features = Sift::default().extract(image, max_keypoints)?;
        let gray = image.gray();
        let (width, height) = (gray.width() as i32, gray.height() as i32);
        let at = |u: f64, v: f64| {
            let (x, y) = ((u as i32).clamp(0, width - 1), (v as i32).clamp(0, height - 1));
            f64::from(gray.row(y as u32)[x as usize])
        };
        let mut descriptors = Descriptors::empty(self.kind());
        for keypoint in &features.keypoints {
            let step = f64::from(keypoint.scale).max(0.7);
            let samples: Vec<f64> = (0..SIDE * SIDE)
                .map(|i| (f64::from(i % SIDE - SIDE / 2) * step, f64::from(i / SIDE - SIDE / 2) * step))
                .map(|(du, dv)| at(keypoint.pixel.u + du, keypoint.pixel.v + dv))
                .collect();
            let mean = samples.iter().sum::<f64>() / samples.len() as f64;
            let norm = samples.iter().map(|s| (s - mean).powi(2)).sum::<f64>().sqrt().max(1e-9);
            let row: Vec<u8> =
                samples.iter().map(|s| Encoding::Signed.byte((s - mean) / norm * Self::NORM)).collect();
            descriptors.push(&row).expect("a row of this kind");
        }
        features.descriptors = descriptors;
        Ok(features)
    }

    /// Radius to the corner of the sampled square.
    fn support_radius(&self) -> f64 {
        f64::from(SIDE / 2) * std::f64::consts::SQRT_2
    }
}

#[test]
fn map_with_user_defined_feature_localizes_and_refuses_other_features() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let scene = rendered::render(folder.path(), 11).expect("rendered");
    let extractors = Extractors::default().with(Patches);

    let mut options = BuildOptions::default();
    options.features = "patches".to_owned();
    let input = Input::new(&scene.posed, &scene.folder);
    let unknown = build(&input, &options, &()).expect_err("the built-in extractors have no patches");
    assert!(unknown.to_string().contains("patches") && unknown.to_string().contains("sift"), "{unknown}");
    let (model, _) = build(&input.with_extractors(&extractors), &options, &()).expect("built");
    assert_eq!(model.profile.descriptor_kind(), Patches.kind());
    let file = folder.path().join("place.vmap");
    write_map(&model, &file).expect("written");
    let map = MapFile::open(&file).expect("opened");

    let sealer = |options| Sealer::new(map.profile(), options).expect("its profile");
    let other = sealer(SealOptions::default());
    let own = sealer(SealOptions::default().with_extractors(extractors));
    let mut rng = rand_chacha::ChaCha20Rng::seed_from_u64(1);
    for (image, truth) in &scene.queries {
        // A device without this extractor refuses: it does not send descriptors of another kind.
        let image = Image::open(image).expect("rendered");
        assert!(other.extract(image.clone(), scene.camera).is_err());
        let extracted = own.extract(image, scene.camera).expect("extracted");
        let query = own.seal(extracted, &mut rng).expect("sealed");
        let query = veiloc::device::SealedQuery::decode(&query.encode()).expect("its own bytes");
        let found = localize(&query, &map, &LocalizeOptions::default()).expect("localized");
        assert!(found.cam_from_world.translation_error(truth) < 0.05, "{}", found.inliers);
    }
}
