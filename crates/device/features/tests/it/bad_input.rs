//! Files that are not images, and images that are too small, flat, not finite, or truncated: typed errors or no
//! keypoints, never a panic.

use std::path::{Path, PathBuf};

use image::{ImageFormat, Rgb, RgbImage};
use veiloc_descriptor::{DescriptorKind, Descriptors, Encoding};
use veiloc_features::{
    Extractor, Extractors, FeatureError, Features, GrayImage, Image, Limits, Sift, SiftOptions, display_turn,
    extract_image, extract_loaded, extract_sift, load_gray,
};

fn count(image: &GrayImage) -> usize {
    extract_sift(image, &SiftOptions::default()).keypoints.len()
}

/// All keypoints are inside the image, finite, and complete.
fn check_keypoints(image: &GrayImage, value: f32) {
    let found = extract_sift(image, &SiftOptions::default());
    assert_eq!(found.descriptors.len(), found.keypoints.len(), "{value}");
    let size = [f64::from(image.width()), f64::from(image.height())];
    for k in &found.keypoints {
        assert!((0.0..size[0]).contains(&k.pixel.u) && (0.0..size[1]).contains(&k.pixel.v), "{value}: {k:?}");
        assert!(k.scale > 0.0 && k.scale.is_finite() && k.orientation.is_finite(), "{value}: {k:?}");
        assert!(k.response.is_finite(), "{value}: {k:?}");
    }
}

fn colourful(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| Rgb([(x * 7) as u8, (y * 5) as u8, ((x * y) % 251) as u8]))
}

fn saved(folder: &Path, name: &str, format: ImageFormat) -> PathBuf {
    let path = folder.join(name);
    colourful(64, 48).save_with_format(&path, format).expect("written");
    path
}

#[test]
fn sizes_and_samples_are_checked() {
    assert!(matches!(GrayImage::new(0, 0, vec![]), Err(FeatureError::Empty { .. })));
    assert!(matches!(GrayImage::new(0, 7, vec![]), Err(FeatureError::Empty { width: 0, height: 7 })));
    let short = GrayImage::new(4, 4, vec![0.0; 15]);
    assert!(matches!(short, Err(FeatureError::Length { expected: 16, actual: 15, .. })));
    assert!(GrayImage::new(u32::MAX, u32::MAX, vec![0.0; 4]).is_err());
    assert!(GrayImage::from_rgb8(2, 2, &[0; 11]).is_err());
    assert!(GrayImage::from_rgba8(2, 2, &[0; 15]).is_err());
    // The pixels of a canvas equal those of the file; transparency is ignored.
    let rgba = [9, 200, 31, 0, 77, 5, 250, 255];
    let rgb: Vec<u8> = rgba.chunks(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    assert_eq!(GrayImage::from_rgba8(2, 1, &rgba).ok(), GrayImage::from_rgb8(2, 1, &rgb).ok());
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut data = vec![0.5; 12];
        data[7] = bad;
        let refused = GrayImage::new(4, 3, data);
        assert!(matches!(refused, Err(FeatureError::NotFinite { column: 3, row: 1 })), "{refused:?}");
    }
}

#[test]
fn small_and_flat_images_have_no_keypoints() {
    for (width, height) in [(1, 1), (1, 500), (2, 2), (3, 3), (8, 8), (200, 150)] {
        let flat = GrayImage::new(width, height, vec![0.5; (width * height) as usize]).expect("finite");
        assert_eq!(count(&flat), 0, "{width}x{height}");
    }
}

#[test]
fn extreme_images_do_not_panic() {
    // Blocks of 5 pixels, dark or light at random: corners and blobs everywhere.
    let blocks = |value: f32| -> Vec<f32> {
        let sign = |x: u32, y: u32| (x * 13 + y * 7 + 1).wrapping_mul(2_654_435_761) >> 31 == 0;
        (0..64 * 64u32).map(|i| if sign(i % 64 / 5, i / 64 / 5) { value } else { -value }).collect()
    };
    for value in [1e-40, 1.0, 1e20, f32::MAX] {
        check_keypoints(&GrayImage::new(64, 64, blocks(value)).expect("finite"), value);
    }
    assert!(count(&GrayImage::new(64, 64, blocks(1.0)).expect("finite")) > 10, "there is something to find");
    let noise = (0..8 * 8u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as f32 / 255.0).collect();
    check_keypoints(&GrayImage::new(8, 8, noise).expect("finite"), 1.0);
    let mut none = SiftOptions::default();
    (none.max_keypoints, none.max_octaves, none.max_orientations) = (0, 0, 0);
    let image = GrayImage::new(64, 64, blocks(1.0)).expect("finite");
    assert!(extract_sift(&image, &none).keypoints.is_empty());
}

#[test]
fn files_load_in_colmap_gray() {
    let folder = tempfile::tempdir().expect("a folder");
    let image = load_gray(&saved(folder.path(), "a.png", ImageFormat::Png)).expect("an image");
    assert_eq!((image.width(), image.height()), (64, 48));
    let Rgb([r, g, b]) = colourful(64, 48)[(10, 20)];
    let luma = (0.2126 * f32::from(r) + 0.7152 * f32::from(g) + 0.0722 * f32::from(b)) / 255.0;
    assert!((image.row(20)[10] - luma).abs() < 1e-6);
    assert!(load_gray(&saved(folder.path(), "a.jpg", ImageFormat::Jpeg)).is_ok());
}

#[test]
fn error_names_a_missing_or_damaged_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let missing = folder.path().join("none.jpg");
    let error = load_gray(&missing).expect_err("it is not there");
    assert!(matches!(error, FeatureError::Read { .. }), "{error}");
    assert!(error.to_string().contains("none.jpg"), "{error}");

    for (name, format) in [("cut.jpg", ImageFormat::Jpeg), ("cut.png", ImageFormat::Png)] {
        let path = saved(folder.path(), name, format);
        let bytes = std::fs::read(&path).expect("just written");
        for keep in [0, 1, 2, 3, 10, bytes.len() / 4, bytes.len() / 2, bytes.len() - 20, bytes.len() - 2] {
            std::fs::write(&path, &bytes[..keep]).expect("written");
            match load_gray(&path) {
                Err(error @ FeatureError::Decode { .. }) => {
                    assert!(error.to_string().contains(name), "{error}");
                }
                other => assert!(
                    keep >= bytes.len() - 20 && format == ImageFormat::Png,
                    "{name} at {keep}: {other:?}"
                ),
            }
        }
    }
    let text = folder.path().join("text.jpg");
    std::fs::write(&text, "not an image").expect("written");
    assert!(matches!(load_gray(&text), Err(FeatureError::Decode { .. })));
}

#[test]
fn huge_image_is_rejected_before_decoding() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = saved(folder.path(), "huge.png", ImageFormat::Png);
    let mut bytes = std::fs::read(&path).expect("just written");
    // Width and height of the header chunk, and its checksum.
    bytes[16..20].copy_from_slice(&60_000u32.to_be_bytes());
    bytes[20..24].copy_from_slice(&60_000u32.to_be_bytes());
    let checksum = crc32(&bytes[12..29]).to_be_bytes();
    bytes[29..33].copy_from_slice(&checksum);
    std::fs::write(&path, bytes).expect("written");
    let error = load_gray(&path).expect_err("too large");
    assert!(matches!(error, FeatureError::TooLarge { width: 60_000, height: 60_000, .. }), "{error}");
}

/// The checksum of PNG chunks.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg()))
    })
}

#[test]
fn limiting_preserves_mean_and_aspect_ratio() {
    let image = GrayImage::new(50, 30, (0..1500).map(|i| (i % 50) as f32 / 50.0).collect()).expect("finite");
    let small = image.clone().limited(20);
    assert_eq!((small.width(), small.height()), (20, 12));
    let mean = |image: &GrayImage| image.data().iter().sum::<f32>() / image.data().len() as f32;
    assert!((mean(&image) - mean(&small)).abs() < 1e-5);
    // A ramp stays a ramp in COLMAP's pixel convention: sample x of the new image is at 2.5 (x + 0.5) of the old one,
    // except for pixels that are divided (0.05 of a pixel, alternating between sides).
    for x in 0..20u32 {
        let expected = (2.5 * (x as f32 + 0.5) - 0.5) / 50.0;
        assert!((small.row(3)[x as usize] - expected).abs() < 0.051 / 50.0);
    }
    assert_eq!(image.clone().limited(50), image);
    assert_eq!(image.limited(0).width(), 1);
}

const LIMITS: Limits = Limits { max_keypoints: 50, max_side: 40 };

#[test]
fn image_size_must_match_the_camera() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = saved(folder.path(), "a.png", ImageFormat::Png);
    let extracted = extract_image(&path, Some((64, 48)), &Sift::default(), LIMITS).expect("it fits");
    assert_eq!((extracted.size_in_file, extracted.size), ((64, 48), (40, 30)));
    let (own, in_file) = (extracted.features.keypoints.clone(), extracted.features_in_file().keypoints);
    for (own, file) in own.iter().zip(&in_file) {
        assert!(
            (own.pixel.u * 1.6 - file.pixel.u).abs() < 1e-9
                && (own.pixel.v * 1.6 - file.pixel.v).abs() < 1e-9
        );
    }
    assert!(
        extract_image(&path, None, &Sift::default(), LIMITS).is_ok(),
        "no camera, nothing to compare with"
    );
    for camera in [(48, 64), (64, 47)] {
        let error = extract_image(&path, Some(camera), &Sift::default(), LIMITS).expect_err("another camera");
        let text = error.to_string();
        assert!(text.contains("64x48") && text.contains(&format!("{}x{}", camera.0, camera.1)), "{text}");
        assert!(!text.contains("rotates the image"), "the file has no orientation: {text}");
    }
}

#[test]
fn image_in_memory_equals_its_file() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = saved(folder.path(), "a.png", ImageFormat::Png);
    let loaded = |camera| {
        let image = Image::from(load_gray(&path).expect("an image")).named("frame 7");
        extract_loaded(image, Some(camera), &Sift::default(), LIMITS)
    };
    let of_file = extract_image(&path, Some((64, 48)), &Sift::default(), LIMITS).expect("it fits");
    let in_memory = loaded((64, 48)).expect("it fits");
    assert_eq!(in_memory.features.keypoints, of_file.features.keypoints);
    assert_eq!((in_memory.size, in_memory.size_in_file), (of_file.size, of_file.size_in_file));
    let text = loaded((48, 64)).expect_err("another camera").to_string();
    assert!(text.starts_with("frame 7: 64x48 pixels") && !text.contains("rotates the image"), "{text}");
}

/// A JPEG as phones write it: pixels in sensor orientation, with an EXIF orientation.
fn turned_jpeg(folder: &Path, orientation: u8) -> PathBuf {
    let plain = std::fs::read(saved(folder, "plain.jpg", ImageFormat::Jpeg)).expect("just written");
    // TIFF, big endian, one directory with one entry: orientation (0x0112), one short.
    let tiff = [b"MM\0\x2A\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0", &[orientation][..], &[0; 6]].concat();
    let body = [b"Exif\0\0", &tiff[..]].concat();
    let length = u16::try_from(body.len() + 2).expect("short").to_be_bytes();
    let path = folder.join("phone.jpg");
    std::fs::write(&path, [&plain[..2], &[0xFF, 0xE1], &length, &body, &plain[2..]].concat())
        .expect("written");
    path
}

#[test]
fn exif_orientation_is_reported_and_never_applied() {
    let folder = tempfile::tempdir().expect("temporary folder");
    for (orientation, degrees) in [(6, Some("90\u{b0}")), (8, Some("270\u{b0}")), (1, None), (3, None)] {
        let path = turned_jpeg(folder.path(), orientation);
        let stored = load_gray(&path).expect("an image");
        assert_eq!((stored.width(), stored.height()), (64, 48), "as it is stored");
        let extract = |camera| extract_image(&path, Some(camera), &Sift::default(), LIMITS);
        assert!(extract((64, 48)).is_ok(), "it fits as it is stored, whatever the orientation");
        let text = extract((48, 64)).expect_err("turned").to_string();
        match degrees {
            Some(degrees) => assert!(text.contains(&format!("rotates the image by {degrees}")), "{text}"),
            None => assert!(!text.contains("rotates the image"), "{orientation}: {text}"),
        }
        let other = extract((100, 64)).expect_err("not even turned").to_string();
        assert!(!other.contains("rotates the image"), "{other}");
    }
}

#[test]
fn display_turn_is_that_of_the_exif_orientation() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let words = ["", "", "mirrored", "rotated by 180\u{b0}", "mirrored and rotated by 180\u{b0}"];
    for (orientation, expected) in
        (1..).zip(&words[1..]).chain([(6, &"rotated by 90\u{b0}"), (8, &"rotated by 270\u{b0}")])
    {
        let turn = display_turn(&turned_jpeg(folder.path(), orientation));
        assert_eq!(turn.map(|turn| turn.to_string()).unwrap_or_default(), *expected, "{orientation}");
    }
    assert_eq!(display_turn(&saved(folder.path(), "plain.jpg", ImageFormat::Jpeg)), None);
    assert_eq!(display_turn(Path::new("no/such.jpg")), None);
}

/// An external extractor: one keypoint in the middle, its brightness as descriptor.
struct Middle {
    rows: usize,
}

impl Extractor for Middle {
    fn kind(&self) -> DescriptorKind {
        DescriptorKind::new("middle", 4, Encoding::Signed, 100).expect("a kind")
    }

    fn extract(&self, image: &Image, _: usize) -> Result<Features, FeatureError> {
        let mut features = extract_sift(image.gray(), &SiftOptions::default());
        features.keypoints.truncate(1);
        features.descriptors = Descriptors::new(self.kind(), vec![200; 4 * self.rows]).expect("whole rows");
        Ok(features)
    }

    fn support_radius(&self) -> f64 {
        0.0
    }
}

#[test]
fn external_extractor_is_found_by_name_and_checked() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = saved(folder.path(), "a.png", ImageFormat::Png);
    let extractors = Extractors::default().with(Middle { rows: 1 });
    assert_eq!(extractors.names(), "sift, compact, middle");
    let kind = extractors.named("middle").expect("it was added").kind();
    let found =
        extract_image(&path, None, extractors.of_kind(kind).expect("by kind"), LIMITS).expect("extracted");
    assert_eq!(found.features.descriptors.kind(), kind);
    let other = DescriptorKind::new("middle", 8, Encoding::Signed, 100).expect("a kind");
    let unknown = extractors.of_kind(other).err().expect("the same name, another kind").to_string();
    assert!(unknown.contains("available: sift, compact, middle"), "{unknown}");
    let broken = extract_image(&path, None, &Middle { rows: 2 }, LIMITS);
    assert!(matches!(broken, Err(FeatureError::Extractor { .. })), "{broken:?}");
}
