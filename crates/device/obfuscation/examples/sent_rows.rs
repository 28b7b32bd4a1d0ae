//! Writes the rows that are sent for images together with the keypoint positions. research/notes/border.py trains on
//! these files (rule L11).
//!
//! ```text
//! sent_rows cut|sent|whole IMAGE OUT [IMAGE OUT]...
//! ```
//!
//! The first argument says how keypoints near the image border are treated, that is, those whose descriptor window
//! crosses the border:
//! - `cut`: they are sent; the descriptor uses only the pixels of the image, as OpenCV and COLMAP do;
//! - `sent`: they are sent; the descriptor is computed on the image continued by its mirror image, as a device does;
//! - `whole`: they are not sent.
//!
//! The camera is estimated from the image size. A file holds, little endian: `u32` N, width and height of the canonical
//! camera; `f32` `[N, 2]`, positions in its image (u, v); `u8` `[N, 128]`. Decoys are not written.

use std::error::Error;
use std::path::Path;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_features::{Extractors, Image, Limits, Sift, extract_image, guessed_camera};
use veiloc_geometry::Pixel;
use veiloc_obfuscation::{Extracted, SealOptions, Sealer};
use veiloc_protocol::Profile;

type BoxError = Box<dyn Error>;

/// More keypoints than a device extracts, before those outside of its window are dropped.
const MAX_KEYPOINTS: usize = 4096;

const USAGE: &str = "the arguments are cut, sent or whole, then pairs of IMAGE and OUT";

fn main() -> Result<(), BoxError> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (border, paths) = arguments.split_first().ok_or(USAGE)?;
    for [image, out] in paths.as_chunks::<2>().0 {
        std::fs::write(out, rows(border, Path::new(image))?)?;
    }
    Ok(())
}

fn rows(border: &str, path: &Path) -> Result<Vec<u8>, BoxError> {
    // The vocabulary does not matter: the global descriptor is not used.
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, (0..=255).collect())?;
    let profile = Profile::vlad(Vocabulary::new(words)?);
    let options = SealOptions::default();
    let (camera, most) = (guessed_camera(path)?, Limits { max_keypoints: MAX_KEYPOINTS, max_side: 1600 });
    let whole = options.clone().with_extractors(Extractors::default());
    let sealer = Sealer::new(&profile, if border == "whole" { whole } else { options })?;
    let extracted = match border {
        "cut" => {
            let image = extract_image(path, Some((camera.width, camera.height)), &Sift::default(), most)?;
            Extracted::new(image.features, camera.resized(image.size.0, image.size.1))
        }
        "sent" | "whole" => sealer.extract(Image::open(path)?, camera)?,
        other => return Err(format!("{other}: write cut, sent or whole").into()),
    };
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (query, truth) = sealer.seal_with_truth(extracted, &mut rng)?;
    let real: Vec<usize> = (0..truth.pixels.len()).filter(|&row| truth.source[row].is_some()).collect();
    let seen = query.camera();
    let mut bytes: Vec<u8> =
        [real.len() as u32, seen.width, seen.height].into_iter().flat_map(u32::to_le_bytes).collect();
    for &row in &real {
        let Pixel { u, v } = truth.pixels[row];
        bytes.extend([u, v].into_iter().flat_map(|at| (at as f32).to_le_bytes()));
    }
    for &row in &real {
        bytes.extend(query.descriptors().expect("rows").row(row));
    }
    Ok(bytes)
}
