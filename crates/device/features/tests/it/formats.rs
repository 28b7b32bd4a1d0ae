//! HEIC and WebP against libheif and libwebp (research/oracles/heic.py), whole and damaged.

use std::path::{Path, PathBuf};

use rand::{Rng, SeedableRng};
use veiloc_features::{
    ColourImage, FeatureError, display_turn, exif_camera, image_size, is_image_file, load_colour, load_gray,
};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// Mean and largest difference of two images, levels of 255.
fn difference(a: &ColourImage, b: &ColourImage) -> (f64, u8) {
    assert_eq!((a.width(), a.height()), (b.width(), b.height()));
    let apart: Vec<u8> = a.data().iter().zip(b.data()).map(|(a, b)| a.abs_diff(*b)).collect();
    (
        apart.iter().map(|&d| f64::from(d)).sum::<f64>() / apart.len() as f64,
        apart.into_iter().max().unwrap_or(0),
    )
}

#[test]
fn pixels_are_those_of_the_reference_decoders_as_they_are_stored() {
    for (name, reference) in [("rotated.heic", "rotated.png"), ("drawn.webp", "drawn_webp.png")] {
        let image = load_colour(&data(name)).expect(name);
        let expected = load_colour(&data(reference)).expect(reference);
        // Decoders interpolate the halved colour channels differently; brightness is the same.
        let (mean, largest) = difference(&image, &expected);
        assert!(mean < 4.0, "{name}: {mean} {largest}");
        let [gray, expected] = [data(name), data(reference)].map(|path| load_gray(&path).expect("an image"));
        let apart =
            gray.data().iter().zip(expected.data()).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>();
        assert!(apart / (gray.data().len() as f64) < 1.0 / 255.0, "{name}: {apart}");
        assert_eq!(image_size(&data(name)).expect(name), (160, 120));
    }
    assert!(is_image_file(Path::new("IMG_1.HEIC")) && is_image_file(Path::new("a.WebP")));
    assert!(!is_image_file(Path::new("a.tif")) && !is_image_file(Path::new("heic")));
}

#[test]
fn exif_of_heic_is_read_as_that_of_jpeg() {
    let path = data("rotated.heic");
    // 26 mm for a diagonal of 43.27 mm.
    let focal = exif_camera(&path).expect("EXIF").pinhole().focal[0];
    assert!((focal - 26.0 * 200.0 / 43.266_615_305_567_87).abs() < 1e-9, "{focal}");
    assert_eq!(display_turn(&path).map(|turn| turn.degrees), Some(90));
}

#[test]
fn damaged_files_are_errors() {
    let folder = tempfile::tempdir().expect("temporary folder");
    for name in ["rotated.heic", "drawn.webp"] {
        let whole = std::fs::read(data(name)).expect(name);
        let path = folder.path().join(name);
        let open = |bytes: &[u8]| {
            std::fs::write(&path, bytes).expect("written");
            let _ = (image_size(&path), display_turn(&path));
            load_gray(&path)
        };
        // The last bytes of a HEIC are its EXIF data.
        for length in (0..whole.len() - 120).step_by(whole.len() / 60) {
            let error =
                open(&whole[..length]).err().unwrap_or_else(|| panic!("{name} {length} of {}", whole.len()));
            assert!(matches!(error, FeatureError::Decode { .. }), "{name} {length}: {error}");
            assert!(error.to_string().contains(name), "{error}");
        }
        // Other bytes give other pixels or an error, never a panic.
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        for _ in 0..300 {
            let mut bytes = whole.clone();
            for _ in 0..random.random_range(1..4) {
                let at = random.random_range(0..bytes.len());
                bytes[at] = random.random();
            }
            let _ = open(&bytes);
        }
    }
}
