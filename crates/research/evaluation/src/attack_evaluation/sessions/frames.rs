//! Frames of a session before sealing.

use crate::EvalError;
use crate::attack_evaluation::person;
use crate::pipeline::PosedQuery;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_features::{Features, GrayImage, Image, load_gray};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Pixel};
use veiloc_map::MapFile;
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::extract_loaded;
use veiloc_protocol::Scheme;
use veiloc_synthetic::problems::normal;

/// A frame as the device has it.
#[derive(Clone)]
pub(super) struct DeviceFrame {
    pub(super) name: String,
    pub(super) features: Features,
    pub(super) camera: Intrinsics,
    /// Its true pose.
    pub(super) cam_from_world: CameraFromWorld,
    /// `[N]` of the features: whether they belong to the private region, whether or not they are sent.
    pub(super) private: Vec<bool>,
}

/// The frame of a query's own image.
pub(super) fn device_frame(
    query: &PosedQuery,
    map: &MapFile,
    private: f64,
    seed: u64,
) -> Result<DeviceFrame, EvalError> {
    let image = load_gray(&query.path)?;
    let mut shown = extracted(query, &query.name, image, map)?;
    let pixels: Vec<Pixel> = shown.features.keypoints.iter().map(|k| k.pixel).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed_for(seed, &[&query.name, "private region"]));
    shown.private = person(&pixels, private, &mut rng);
    Ok(shown)
}

/// Frames of a stationary camera: the image itself, and copies with new sensor noise, gray levels of 255.
pub(super) fn stationary_frames(
    query: &PosedQuery,
    own: &DeviceFrame,
    frames: usize,
    noise: f64,
    map: &MapFile,
    seed: u64,
) -> Result<Vec<DeviceFrame>, EvalError> {
    let image = load_gray(&query.path)?;
    let again = (1..frames).map(|k| {
        let name = format!("{} again {k}", query.name);
        let mut rng = ChaCha8Rng::seed_from_u64(seed_for(seed, &[&name, "sensor"]));
        extracted(query, &name, with_noise(&image, noise, &mut rng), map)
    });
    std::iter::once(Ok(own.clone())).chain(again).collect()
}

fn with_noise(image: &GrayImage, noise: f64, rng: &mut impl Rng) -> GrayImage {
    let one = |v: &f32| (f64::from(*v) * 255.0 + noise * normal(rng)).round().clamp(0.0, 255.0) as u8;
    let bytes: Vec<u8> = image.data().iter().map(one).collect();
    GrayImage::from_luma8(image.width(), image.height(), &bytes).expect("as many samples as before")
}

fn extracted(
    query: &PosedQuery,
    name: &str,
    image: GrayImage,
    map: &MapFile,
) -> Result<DeviceFrame, EvalError> {
    let options = options_for(Scheme::default());
    let (features, camera) =
        extract_loaded(Image::from(image), &query.path, &query.camera, map.profile(), &options)?;
    Ok(DeviceFrame {
        name: name.to_owned(),
        features,
        camera,
        cam_from_world: query.cam_from_world,
        private: Vec::new(),
    })
}
