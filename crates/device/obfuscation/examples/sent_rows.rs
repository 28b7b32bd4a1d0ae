//! Writes what is sent of images beside where it was in them: what research/notes/border.py learns from (rule L11).
//!
//! ```text
//! sent_rows cut|sent|whole IMAGE OUT [IMAGE OUT]...
//! ```
//!
//! What becomes of keypoints whose descriptor looks over the image's border:
//! - `cut`: they stay, described by what the image shows, as OpenCV and COLMAP do;
//! - `sent`: they stay, described by the image continued by its mirror image, which is what a device does;
//! - `whole`: they are left out.
//!
//! The camera is guessed. A file holds, little endian: `u32` N, width and height of the canonical camera;
//! `f32` `[N, 2]`, positions in its image (u, v); `u8` `[N, 128]`. Decoys are left out.

use std::error::Error;
use std::path::Path;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_features::{Extractors, Limits, Sift, extract_image, guessed_camera};
use veiloc_geometry::Pixel;
use veiloc_obfuscation::{SealOptions, extract, extract_with, seal_with_truth};
use veiloc_protocol::Profile;

type Fault = Box<dyn Error>;

/// More than a device extracts before it drops what lies beyond its window.
const MOST: usize = 4096;

fn main() -> Result<(), Fault> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (border, paths) = arguments.split_first().ok_or("cut, sent or whole, then images and files")?;
    for [image, out] in paths.as_chunks::<2>().0 {
        std::fs::write(out, rows(border, Path::new(image))?)?;
    }
    Ok(())
}

fn rows(border: &str, path: &Path) -> Result<Vec<u8>, Fault> {
    // Any words do: the global descriptor is not looked at.
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, (0..=255).collect())?;
    let profile = Profile::vlad(Vocabulary::new(words)?);
    let options = SealOptions::default();
    let (camera, most) = (guessed_camera(path)?, Limits { max_keypoints: MOST, max_side: 1600 });
    let (features, camera) = match border {
        "cut" => {
            let image = extract_image(path, Some((camera.width, camera.height)), &Sift::default(), most)?;
            (image.features, camera.resized(image.size.0, image.size.1))
        }
        "sent" => extract(path, &camera, &profile, &options)?,
        "whole" => extract_with(&Extractors::default(), path, &camera, &profile, &options)?,
        other => return Err(format!("{other}: cut, sent or whole").into()),
    };
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (query, truth) = seal_with_truth(features, &camera, &profile, &options, &mut rng)?;
    let real: Vec<usize> = (0..truth.pixels.len()).filter(|&row| truth.source[row].is_some()).collect();
    let seen = query.camera();
    let mut bytes: Vec<u8> =
        [real.len() as u32, seen.width, seen.height].into_iter().flat_map(u32::to_le_bytes).collect();
    for &row in &real {
        let Pixel { u, v } = truth.pixels[row];
        bytes.extend([u, v].into_iter().flat_map(|at| (at as f32).to_le_bytes()));
    }
    for &row in &real {
        bytes.extend(query.descriptors().row(row));
    }
    Ok(bytes)
}
