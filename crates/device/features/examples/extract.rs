//! Extracts the features of images into raw files, for research/oracles/features.py and for timing.
//!
//! ```text
//! extract [--max N] [--no-upsample] [--peak P] [--compact] [--repeat N] IMAGE OUT [IMAGE OUT]...
//! ```
//!
//! A file holds, little endian: `u32` N; `f32` `[N, 5]` (u, v, scale, orientation, response); `u8` `[N, 128]`, or `[N, 64]` with
//! `--compact`. OUT `-` writes nothing. `--repeat` prints the fastest of N extractions. RAYON_NUM_THREADS sets the threads.
#![expect(clippy::print_stderr, reason = "a command-line program")]

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use veiloc_features::{Features, GrayImage, SiftOptions, compact, extract_sift, load_gray};

fn main() -> Result<(), Box<dyn Error>> {
    let mut options = SiftOptions::default();
    let (mut repeat, mut small) = (0, false);
    let mut paths = Vec::new();
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or("a value is missing");
        match argument.as_str() {
            "--max" => options.max_keypoints = value()?.parse()?,
            "--peak" => options.peak_threshold = value()?.parse()?,
            "--repeat" => repeat = value()?.parse()?,
            "--compact" => small = true,
            "--no-upsample" => options.upsample = false,
            _ => paths.push(argument),
        }
    }
    let extract = |image: &GrayImage| {
        let features = extract_sift(image, &options);
        let descriptors = if small { compact(&features.descriptors) } else { features.descriptors };
        Features { descriptors, ..features }
    };
    for pair in paths.chunks_exact(2) {
        let image = load_gray(Path::new(&pair[0]))?;
        let features = extract(&image);
        if pair[1] != "-" {
            std::fs::write(&pair[1], raw(&features))?;
        }
        let best = (0..repeat)
            .map(|_| {
                let start = Instant::now();
                std::hint::black_box(extract(&image));
                start.elapsed()
            })
            .min();
        if let Some(best) = best {
            let ms = best.as_secs_f64() * 1e3;
            eprintln!("{}: {image:?}, {features:?}, {ms:.1} ms", pair[0]);
        }
    }
    Ok(())
}

fn raw(features: &Features) -> Vec<u8> {
    let mut bytes = (features.keypoints.len() as u32).to_le_bytes().to_vec();
    for keypoint in &features.keypoints {
        let pixel = [keypoint.pixel.u as f32, keypoint.pixel.v as f32];
        for value in [pixel[0], pixel[1], keypoint.scale, keypoint.orientation, keypoint.response] {
            bytes.extend(value.to_le_bytes());
        }
    }
    bytes.extend(features.descriptors.as_bytes());
    bytes
}
